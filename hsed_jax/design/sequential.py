r"""Sequential experimental design (Abbiati & Marelli, section 2.3) as pure `init`, `ask`, `tell`.

`ask` is Steps 2 to 6: calibrate on what has been measured, form the discrepancy norm, fit its Kriging, and take the candidate
that maximises the acquisition.  Whoever performs the experiment (Step 7) answers with `tell`.  Loop, files and progress live
elsewhere.  Arrays have the planned size from the start, so every step runs the programs of the first.

Experiments that are asked and not yet measured are pending: their inputs are not asked again, and the surrogate believes its own
mean there (the Kriging believer of Ginsbourger, Le Riche & Carraro 2010), so that several can be out at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.acquisition import ACQUISITIONS, Acquisition, Choice, Restricted, choose, sobol_candidates
from hsed_jax.design.discrepancy import discrepancy, variance_over
from hsed_jax.design.feasible import near_failures
from hsed_jax.design.kriging import Kriging, condition, fit_kriging
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Data, data_of
from hsed_jax.inference.maximum import Maximum, maximise
from hsed_jax.inference.nuts import Chains, Convergence, Settings, convergence
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.sampling import draw
from hsed_jax.physics.simulator import Conditions

# Inputs that stand for the whole space in the variance of Eq. 12.
_SPREAD = 256


@dataclass(frozen=True)
class DesignState:
    """All that the next step needs.

    Attributes:
        cube: asked inputs in the unit cube, planned size (N, d).
        conditions: SI inputs by name, each (N,).
        outputs: measured outputs, SI, (N, J); NaN where missing or not yet measured.
        count: how many experiments there are.
        status: of each experiment, as in `Experiment`; empty beyond `count`, (N,).
        theta: last MAP in unconstrained coordinates, a start of the next; None before the first.
        step_size: of NUTS, to go on from.
    """

    cube: np.ndarray
    conditions: dict[str, np.ndarray]
    outputs: np.ndarray
    count: int = 0
    status: np.ndarray = field(default_factory=lambda: np.empty(0, dtype="U9"))
    theta: np.ndarray | None = None
    step_size: float = 0.8


class StepInfo(NamedTuple):
    """What one step found, for reports: nothing of it is needed to go on.

    Attributes:
        maximum: MAP, covariance, evidence.
        chains: the posterior's draws.
        convergence: whether to believe them.
        discrepancy: Eq. 12 at the tested inputs, (count,); NaN where the model diverged or nothing was measured.
        kriging: the surrogate of it.
        value: the acquisition at the chosen input (expected improvement, if that is the acquisition).
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
        gaps: of the columns, time since the sample before of the same history [s], (J,).
        settings: of the sample at each step.
        starts: of the MAP.
        candidates: size of the candidate set.
        acquisition: name of it.
        kriging: options of `fit_kriging`.
        variance_over_parameters: take the variance of Eq. 12 over the posterior of θ, too.
        seed: of the candidate set.
        exceeding: which candidates (M, d) exceed a limit of the specimen, from draws of the posterior (n, p): (M,) bool.
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

    def init(self) -> DesignState:
        """No experiment yet."""
        n, d, j = self.size, len(self.space.names), len(self.gaps)
        # Padding repeats a valid input, so that padded simulations are harmless.
        middle = self.space.declared(np.full((n, d), 0.5))
        return DesignState(
            np.full((n, d), 0.5), self.space.si(middle), np.full((n, j), np.nan), 0, np.full(n, "", dtype="U9")
        )

    def tell(
        self,
        state: DesignState,
        cube: Sequence[float],
        outputs: Sequence[float],
        status: str | None = None,
        row: int | None = None,
    ) -> DesignState:
        """Add an experiment, or say what became of one that is there.

        Arguments:
            cube: its inputs in the unit cube, (d,); they may differ from those that were asked.
            outputs: measured outputs, SI, (J,); NaN where missing.
            status: `completed`, `pending`, `failed` or `abandoned`; by default whether there is an output.
            row: of the experiment, where it is there already.
        """
        i = state.count if row is None else row
        if i >= self.size:
            raise ValueError(f"The design was planned for {self.size} experiments, and all of them are there.")
        si = self.space.si(self.space.declared(np.asarray(cube)[None]))
        points, values, states = state.cube.copy(), state.outputs.copy(), state.status.copy()
        points[i], values[i] = cube, outputs
        states[i] = status or ("completed" if np.isfinite(values[i]).any() else "failed")
        conditions = {name: np.concatenate([x[:i], si[name], x[i + 1 :]]) for name, x in state.conditions.items()}
        count = max(state.count, i + 1)
        return replace(state, cube=points, conditions=conditions, outputs=values, count=count, status=states)

    def larger(self, state: DesignState) -> tuple["SequentialDesign", DesignState]:
        """The same design with room for twice as many experiments; its programs compile anew."""
        design = replace(self, size=2 * self.size)
        grown, n = design.init(), self.size
        conditions = {name: np.concatenate([state.conditions[name], x[n:]]) for name, x in grown.conditions.items()}
        tables = {
            name: np.concatenate([getattr(state, name), getattr(grown, name)[n:]])
            for name in ("cube", "outputs", "status")
        }
        return design, replace(state, conditions=conditions, **tables)

    def data(self, state: DesignState) -> Data:
        """The measured experiments, padded to the planned size."""
        conditions = Conditions({name: jnp.asarray(x) for name, x in state.conditions.items()})
        gaps = np.broadcast_to(self.gaps, state.outputs.shape)
        return data_of(conditions, state.outputs, np.isfinite(state.outputs), gaps, state.count)

    def ask(
        self, state: DesignState, key: PRNGKeyArray, acquisition: Acquisition | None = None
    ) -> tuple[np.ndarray, DesignState, StepInfo]:
        """Steps 2 to 6: the next input in the unit cube (d,), the state to go on from, and what was found.

        Arguments:
            state: the experiments so far.
            key: of the random numbers.
            acquisition: what to choose by; by default the one named `acquisition`.

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
            known = jnp.asarray(state.cube), jnp.asarray(np.arange(self.size) < state.count)
            return choose(believing, self.candidate_set, *known, by, of_choice)

        best = chosen_by(ACQUISITIONS["expected_improvement"])
        choice = best
        if acquisition is not None or self.acquisition != "expected_improvement":
            choice = chosen_by(acquisition or ACQUISITIONS[self.acquisition])
        chosen = np.asarray(self.candidate_set[int(choice.index)])
        info = StepInfo(
            maximum,
            chains,
            convergence(chains),
            norms[: state.count],
            surrogate,
            float(choice.value),
            float(best.value),
            chosen,
        )
        going_on = replace(state, theta=np.asarray(maximum.u), step_size=float(np.mean(chains.step_size)))
        return chosen, going_on, info

    def _fit(self, state: DesignState, norms: np.ndarray, key: PRNGKeyArray) -> Kriging:
        mask = self._measured(state) & np.isfinite(norms)
        responses = jnp.asarray(np.where(mask, norms, 0.0))
        return fit_kriging(jnp.asarray(state.cube), responses, jnp.asarray(mask), key=key, **self.kriging)

    def _believing(self, state: DesignState, kriging: Kriging, norms: np.ndarray) -> Kriging:
        """The surrogate with its own mean as the response of every pending experiment."""
        pending = state.status == "pending"
        if not pending.any():
            return kriging
        believed = np.where(pending, np.asarray(kriging.predict(jnp.asarray(state.cube))[0]), norms)
        return self._conditioned(state, believed, pending, kriging.lengths, kriging.nugget)

    def _closed(self, state: DesignState, draws: Float[Array, "c s p"]) -> np.ndarray | None:
        """Candidates that are not to be asked, (M,); None where all may be.

        Raises:
            UserError: none is left.
        """
        closed = near_failures(np.asarray(self.candidate_set), state.cube[state.status == "failed"],
                               state.cube[state.status == "completed"])  # fmt: skip
        if self.exceeding is not None:
            closed = closed | self.exceeding(np.asarray(draws).reshape(-1, draws.shape[-1]), self.candidate_set)
        if closed.all():
            raise UserError(
                "every candidate is predicted to exceed a limit (design.limits) or lies where experiments failed; "
                "widen the limits or the inputs"
            )
        return closed if closed.any() else None

    def _check_enough(self, state: DesignState) -> None:
        usable, terms = int(self._measured(state).sum()), len(self.space.names)
        needed = {"constant": 1, "linear": 1 + terms, "quadratic": (terms + 1) * (terms + 2) // 2}
        least = 1 + needed[self.kriging.get("trend", "constant")]
        if usable < least:
            raise UserError(
                f"only {usable} of {state.count} experiments gave something to use, and the design needs {least} to go on; "
                "perform more initial experiments (design.initial) or choose inputs that can be tested"
            )

    def _measured(self, state: DesignState) -> np.ndarray:
        """Which experiments gave something; one that failed is tested but says nothing of the discrepancy."""
        return (np.arange(self.size) < state.count) & np.isfinite(state.outputs).any(axis=1)

    def surrogate(self, state: DesignState, norms: Sequence[float], lengths: Sequence[float], nugget: float) -> Kriging:
        """The Kriging of a step again, from what the journal keeps of it.

        Arguments:
            norms: discrepancies the step found, (count then,); NaN where there is none.
            lengths, nugget: hyper-parameters of its Kriging.
        """
        responses = np.full(self.size, np.nan)
        responses[: len(norms)] = norms
        return self._conditioned(
            state, responses, np.zeros(self.size, dtype=bool), jnp.asarray(lengths), jnp.asarray(nugget)
        )

    def _conditioned(
        self, state: DesignState, responses: np.ndarray, more: np.ndarray, lengths: Array, nugget: Array
    ) -> Kriging:
        """Kriging of known hyper-parameters on what was measured, and on `more` rows."""
        mask = (self._measured(state) | more) & np.isfinite(responses)
        options = {name: value for name, value in self.kriging.items() if name != "starts"}
        return condition(
            jnp.asarray(state.cube),
            jnp.asarray(np.where(mask, responses, 0.0)),
            jnp.asarray(mask),
            lengths,
            nugget,
            **options,
        )

    def starting_points(self, state: DesignState) -> Float[Array, "s p"]:
        """Where the MAP starts: spread over the prior, and the last MAP instead of the first of them."""
        spread = self._starts
        return spread if state.theta is None else spread.at[0].set(jnp.asarray(state.theta))

    @cached_property
    def _starts(self):
        return self.posterior.starts(self.starts)

    @cached_property
    def candidate_set(self):
        """Inputs to choose from, in the unit cube, (candidates, d)."""
        return sobol_candidates(self.candidates, len(self.space.names), self.seed)

    def _discrepancy(self, data: Data, theta: Float[Array, " p"], draws: Float[Array, "c s p"]) -> Float[Array, " n"]:
        """Eq. 12 at the tested inputs; NaN where the model diverged or nothing was measured."""
        thetas = theta[None]
        if self.variance_over_parameters:
            thetas = draws.reshape(-1, draws.shape[-1])[:: max(1, draws.shape[0] * draws.shape[1] // 16)]
        return _discrepancies(self.posterior, data, theta, thetas, self._spread)

    @cached_property
    def _spread(self) -> Conditions:
        """Inputs over the whole space, that the variance in Eq. 12 is taken over."""
        inputs = self.space.si(self.space.declared(self.space.spread(_SPREAD)))
        return Conditions({name: jnp.asarray(values) for name, values in inputs.items()})


@eqx.filter_jit
def _discrepancies(posterior, data, theta, thetas, spread):
    here, ok = posterior.predict(posterior.of_model(theta), data.conditions, data.count)
    there, good = jax.vmap(lambda t: posterior.predict(posterior.of_model(t), spread, jnp.asarray(_SPREAD)))(thetas)
    variance = variance_over(there.reshape(-1, there.shape[-1]), good.ravel(), posterior.groups)
    norms = discrepancy(data.values, here, variance, data.weights, posterior.groups)
    # Where the model diverged there is no discrepancy, which is not the same as none.
    return jnp.where(ok > 0, norms, jnp.nan)
