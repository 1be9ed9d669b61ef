r"""Sequential experimental design (Abbiati & Marelli, section 2.3) as pure `init`, `ask`, `tell`.

`ask` is Steps 2 to 6: calibrate on the measured experiments, compute the discrepancy norm, fit its Kriging, and choose the
candidate that maximises the acquisition.  The laboratory that performs the experiment (Step 7) answers with `tell`.  Loop,
files and progress live elsewhere.  Arrays have the planned size from the start, so every step runs the programs of the first.

Requested experiments without measurements are pending. Their inputs are not requested again, and the surrogate uses its own
mean there (the Kriging believer of Ginsbourger, Le Riche & Carraro 2010), so that several experiments can be pending.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.acquisition import Choice, PerCost, Restricted, choose, sobol_candidates
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.design.acquisitions.base import Acquisition
from hsed_jax.design.acquisitions.expected_improvement import ExpectedImprovement
from hsed_jax.design.cost import Cost
from hsed_jax.design.discrepancy import discrepancy, variance_over
from hsed_jax.design.drift import Drift, shares
from hsed_jax.design.feasible import near_failures, too_near
from hsed_jax.design.kriging import Kriging, condition, fit_kriging
from hsed_jax.design.space import InputSpace, Point
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Data, data_of
from hsed_jax.inference.maximum import Maximum, maximise
from hsed_jax.inference.nuts import Chains, Convergence, Settings, convergence
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.sampling import draw
from hsed_jax.physics.simulator import Conditions
from hsed_jax.programs import program

# Number of inputs that represent the whole space in the variance of Eq. 12.
_SPREAD = 256


class Trial(NamedTuple):
    """An experiment of a design.

    Attributes:
        point: its inputs: as tested if known, otherwise as requested.
        outputs: what was measured, SI, (J,); NaN where missing or not yet measured.
        status: as of an `Experiment`.
    """

    point: Point
    outputs: np.ndarray
    status: str


@dataclass(frozen=True)
class DesignState:
    """The state that the next step needs.

    Attributes:
        trials: the requested or reported experiments, in that order.
        theta: last MAP in unconstrained coordinates, a start of the next; None before the first.
        step_size: of NUTS, for the next step.
    """

    trials: tuple[Trial, ...] = ()
    theta: np.ndarray | None = None
    step_size: float = 0.8

    @property
    def cube(self) -> np.ndarray:
        """Inputs of the trials in the unit cube, (n, d)."""
        return np.asarray([trial.point.cube for trial in self.trials])

    @property
    def status(self) -> np.ndarray:
        """Status of each trial, (n,)."""
        return np.asarray([trial.status for trial in self.trials], dtype=str)

    @property
    def is_measured(self) -> np.ndarray:
        """The trials with results, (n,); a failed trial is tested but has no discrepancy."""
        return np.asarray([np.isfinite(trial.outputs).any() for trial in self.trials], dtype=bool)


class StepInfo(NamedTuple):
    """Results of one step for reports; the next step does not need them.

    Attributes:
        maximum: MAP, covariance, evidence.
        chains: the posterior's draws.
        convergence: their diagnostics.
        discrepancy: Eq. 12 at the tested inputs, (count,); NaN where the model diverged or nothing was measured.
        kriging: the surrogate of it.
        value: the acquisition at the chosen input (expected improvement, if that is the acquisition), divided by the cost.
        expected_improvement: the largest expected improvement over the candidates (Eq. 14).
        chosen: next input in the unit cube, (d,).
    """

    maximum: Maximum
    chains: Chains
    convergence: Convergence
    discrepancy: np.ndarray
    kriging: Kriging
    value: float
    expected_improvement: float
    chosen: np.ndarray


@dataclass(frozen=True)
class SequentialDesign:
    """The procedure for one study.

    Attributes:
        posterior: of the study.
        space: of the inputs.
        size: planned number of experiments, initial ones included.
        gaps: of the columns, time since the previous sample of the same history [s], (J,).
        settings: of the sample at each step.
        starts: of the MAP.
        candidates: size of the candidate set.
        acquisition: name of it.
        kriging: options of `fit_kriging`.
        variance_over_parameters: take the variance of Eq. 12 over the posterior of θ, too.
        seed: of the candidate set.
        exceeding: which candidates (M, d) exceed a limit of the specimen, from draws of the posterior (n, p): (M,) bool.
        cost: of experiments; the acquisition is divided by it.
        replicates: whether inputs of earlier experiments, or inputs next to them, may be requested.
    """

    posterior: Posterior
    space: InputSpace
    size: int
    gaps: np.ndarray
    settings: Settings
    starts: int
    candidates: int
    acquisition: str
    kriging: dict[str, Any]
    variance_over_parameters: bool
    seed: int
    exceeding: Callable[[np.ndarray, Array], np.ndarray] | None = None
    cost: Cost | None = None
    replicates: bool = False

    def init(self) -> DesignState:
        """No experiment yet."""
        return DesignState()

    def tell(
        self,
        state: DesignState,
        cube: Sequence[float],
        outputs: Sequence[float],
        status: str | None = None,
        row: int | None = None,
    ) -> DesignState:
        """Add an experiment, or the result of an existing one.

        Arguments:
            cube: its inputs in the unit cube, (d,); they may differ from those that were asked.
            outputs: measured outputs, SI, (J,); NaN where missing.
            status: `completed`, `pending`, `failed` or `abandoned`; by default whether there is an output.
            row: of the experiment, if it already exists.
        """
        i, values = len(state.trials) if row is None else row, np.asarray(outputs, dtype=float)
        status = status or ("completed" if np.isfinite(values).any() else "failed")
        trial = Trial(self.space.point(np.asarray(cube)), values, status)
        return replace(state, trials=(*state.trials[:i], trial, *state.trials[i + 1 :]))

    def size_of(self, state: DesignState) -> int:
        """Rows of the arrays: the planned number, doubled until all reported experiments have room; each doubling needs
        a new compilation.
        """
        size = self.size
        while size < len(state.trials):
            size *= 2
        return size

    def data(self, state: DesignState) -> Data:
        """The measured experiments, padded to the planned size."""
        size, count = self.size_of(state), len(state.trials)
        # Padding repeats a valid input, so that padded simulations are harmless.
        points = [*(t.point for t in state.trials), *[self._middle] * (size - count)]
        conditions = Conditions(jax.device_put({n: np.asarray([p.si[n] for p in points]) for n in self.space.names}))
        outputs = np.full((size, len(self.gaps)), np.nan)
        for row, trial in enumerate(state.trials):
            outputs[row] = trial.outputs
        gaps = np.broadcast_to(self.gaps, outputs.shape)
        return data_of(conditions, outputs, np.isfinite(outputs), gaps, count)

    def ask(
        self, state: DesignState, key: PRNGKeyArray, acquisition: Acquisition | None = None
    ) -> tuple[np.ndarray, DesignState, StepInfo]:
        """Steps 2 to 6: the next input in the unit cube (d,), the next state, and the results.

        Arguments:
            state: the experiments so far.
            key: of the random numbers.
            acquisition: the criterion; by default the one named `acquisition`.

        Raises:
            UserError: too many experiments failed for a Kriging of the others.
        """
        self._check_enough(state)
        of_draws, of_kriging, of_choice = jax.random.split(key, 3)
        data = self.data(state)
        maximum = maximise(self.posterior, data, self.starting_points(state))
        chains = draw(self.posterior, data, maximum, jnp.asarray(state.step_size), of_draws, self.settings)
        norms = np.asarray(self._discrepancy(data, maximum.theta, chains.theta))
        surrogate = self._fit(state, norms, of_kriging)
        believing = self._believing(state, surrogate, norms)
        closed = self._closed(state, chains.theta)

        def chosen_by(by: Acquisition) -> Choice:
            if closed is not None:
                by = Restricted(by, jnp.asarray(closed))
            excluded = np.full(len(state.trials), not self.replicates)
            known = jax.device_put((self._cube(state), self._rows(state, excluded)))
            return choose(believing, self.candidate_set, *known, acquisition=by, key=of_choice)

        best = chosen_by(ExpectedImprovement())
        choice, by = best, acquisition or ACQUISITIONS[self.acquisition]()
        if self.cost is not None:
            choice = chosen_by(PerCost(by, jnp.asarray(self.cost(self.space.declared(self.candidate_set)))))
        elif not isinstance(by, ExpectedImprovement):
            choice = chosen_by(by)
        chosen = np.asarray(self.candidate_set)[int(choice.index)]
        info = StepInfo(
            maximum,
            chains,
            convergence(chains),
            norms[: len(state.trials)],
            surrogate,
            float(choice.value),
            float(best.value),
            chosen,
        )
        going_on = replace(state, theta=np.asarray(maximum.u), step_size=float(np.asarray(chains.step_size).mean()))
        return chosen, going_on, info

    def _cube(self, state: DesignState) -> np.ndarray:
        """Inputs of the trials in the unit cube, padded, (N, d)."""
        points = np.full((self.size_of(state), len(self.space.names)), 0.5)
        points[: len(state.trials)] = state.cube.reshape(-1, points.shape[1])
        return points

    def _rows(self, state: DesignState, chosen: np.ndarray) -> np.ndarray:
        """Trials that are chosen, as rows of the padded arrays, (N,)."""
        rows = np.zeros(self.size_of(state), dtype=bool)
        rows[: len(chosen)] = chosen
        return rows

    def _fit(self, state: DesignState, norms: np.ndarray, key: PRNGKeyArray) -> Kriging:
        mask = self._rows(state, state.is_measured) & np.isfinite(norms)
        known = jax.device_put((self._cube(state), np.where(mask, norms, 0.0), mask))
        return fit_kriging(*known, key=key, **self.kriging)

    def _believing(self, state: DesignState, kriging: Kriging, norms: np.ndarray) -> Kriging:
        """The surrogate with its own mean as the response of every pending experiment."""
        pending = self._rows(state, state.status == "pending")
        if not pending.any():
            return kriging
        believed = np.where(pending, np.asarray(kriging.predict(jnp.asarray(self._cube(state)))[0]), norms)
        return self._conditioned(state, believed, pending, kriging.lengths, kriging.nugget)

    def _closed(self, state: DesignState, draws: Float[Array, "c s p"]) -> np.ndarray | None:
        """Excluded candidates, (M,); None if all are allowed.

        Raises:
            UserError: none is left.
        """
        candidates, tested = np.asarray(self.candidate_set), state.cube
        closed = near_failures(candidates, tested[state.status == "failed"], tested[state.status == "completed"])
        if self.exceeding is not None:
            closed = closed | self.exceeding(np.asarray(draws).reshape(-1, draws.shape[-1]), self.candidate_set)
        if closed.all():
            raise UserError(
                "every candidate is predicted to exceed a limit (design.limits) or lies where experiments failed; "
                "widen the limits or the inputs"
            )
        if not self.replicates:
            closed = closed | too_near(candidates, tested, self.size_of(state), closed)
        return closed if closed.any() else None

    def drift(self, state: DesignState) -> Drift:
        """The difference between the estimates of these experiments and those of experiments spread evenly over the inputs."""
        data, used = self.data(state), state.is_measured
        weights = np.zeros(len(data.values))
        of_each = shares(state.cube[used], np.asarray(self.candidate_set))
        weights[: len(used)][used] = of_each * used.sum()
        evenly = data._replace(weights=data.weights * jnp.asarray(weights)[:, None])
        designed, spread = (maximise(self.posterior, one, self.starting_points(state)) for one in (data, evenly))
        sd = np.sqrt(np.diag(np.asarray(designed.covariance)))

        def by_name(values: Any) -> dict[str, float]:
            return dict(zip(self.posterior.reported, np.asarray(values).tolist(), strict=False))

        return Drift(by_name(designed.theta), by_name(spread.theta), by_name(sd))

    @property
    def least(self) -> int:
        """How many measured experiments a step needs."""
        terms = len(self.space.names)
        needed = {"constant": 1, "linear": 1 + terms, "quadratic": (terms + 1) * (terms + 2) // 2}
        return 1 + needed[self.kriging.get("trend", "constant")]

    def _check_enough(self, state: DesignState) -> None:
        usable, least = int(state.is_measured.sum()), self.least
        if usable < least:
            is_out = (state.status == "pending").any()
            mend = "perform more initial experiments (design.initial) or choose inputs that can be tested"
            raise UserError(
                f"only {usable} of {len(state.trials)} experiments have usable results, but the design needs "
                f"{least} to continue; {'tell the results of the pending experiments first' if is_out else mend}"
            )

    def surrogate(self, state: DesignState, norms: Sequence[float], lengths: Sequence[float], nugget: float) -> Kriging:
        """The Kriging of a step, from its entry in the journal.

        Arguments:
            norms: discrepancies of the step, (count then,); NaN without one.
            lengths, nugget: hyper-parameters of its Kriging.
        """
        responses = np.full(self.size_of(state), np.nan)
        responses[: len(norms)] = norms
        hyper = jax.device_put((np.asarray(lengths, dtype=float), np.asarray(nugget, dtype=float)))
        return self._conditioned(state, responses, np.zeros(len(responses), dtype=bool), *hyper)

    def _conditioned(
        self, state: DesignState, responses: np.ndarray, more: np.ndarray, lengths: Array, nugget: Array
    ) -> Kriging:
        """Kriging with known hyper-parameters on the measured experiments, and on `more` rows."""
        mask = (self._rows(state, state.is_measured) | more) & np.isfinite(responses)
        options = {name: value for name, value in self.kriging.items() if name != "starts"}
        known = jax.device_put((self._cube(state), np.where(mask, responses, 0.0), mask))
        return condition(*known, lengths=lengths, nugget=nugget, **options)

    def starting_points(self, state: DesignState) -> Float[np.ndarray, "s p"]:
        """Starts of the search for the MAP: spread over the prior, with the last MAP instead of the first of them."""
        points = np.array(self._starts)
        if state.theta is not None:
            points[0] = state.theta
        return points

    @cached_property
    def _starts(self):
        return self.posterior.starts(self.starts)

    @cached_property
    def _middle(self) -> Point:
        return self.space.point(np.full(len(self.space.names), 0.5))

    @cached_property
    def candidate_set(self):
        """Inputs to choose from, in the unit cube, (candidates, d)."""
        return sobol_candidates(self.candidates, len(self.space.names), self.seed)

    def _discrepancy(self, data: Data, theta: Float[Array, " p"], draws: Float[Array, "c s p"]) -> Float[Array, " n"]:
        """Eq. 12 at the tested inputs; NaN where the model diverged or nothing was measured."""
        thetas = np.asarray(theta)[None]
        if self.variance_over_parameters:
            thetas = np.asarray(draws).reshape(-1, draws.shape[-1])[:: max(1, draws.shape[0] * draws.shape[1] // 16)]
        return _discrepancies(self.posterior, data, theta, thetas, self._spread)

    @cached_property
    def _spread(self) -> Conditions:
        """Inputs over the whole space, for the variance in Eq. 12."""
        inputs = self.space.si(self.space.declared(self.space.spread(_SPREAD)))
        return Conditions(jax.device_put(inputs))


@program
def _discrepancies(posterior, data, theta, thetas, spread):
    # One batch for the whole space and the tested inputs: the simulation is most of the compilation.
    number, tested = len(thetas) * _SPREAD, len(data.values)
    over = jnp.repeat(jax.vmap(posterior.of_model)(thetas), _SPREAD, axis=0)
    at = jnp.concatenate([over, jnp.tile(posterior.of_model(theta), (tested, 1))])
    batch = jax.tree.map(lambda s, d: jnp.concatenate([jnp.tile(s, len(thetas)), d]), spread, data.conditions)
    predicted, good = posterior.predict(at, batch, number + data.count)
    here, ok = predicted[number:], good[number:]
    variance = variance_over(predicted[:number], good[:number], posterior.groups)
    norms = discrepancy(data.values, here, variance, data.weights, posterior.groups)
    # A diverged model has an unknown discrepancy, not a zero one.
    return jnp.where(ok > 0, norms, jnp.nan)
