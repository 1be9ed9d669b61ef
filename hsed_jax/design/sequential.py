r"""Sequential experimental design (Abbiati & Marelli, section 2.3) as pure `init`, `ask`, `tell`.

`ask` is Steps 2 to 6: calibrate on what has been measured, form the discrepancy norm, fit its Kriging, and take the candidate
that maximises the acquisition.  Whoever performs the experiment (Step 7) answers with `tell`.  Loop, files and progress live
elsewhere.  Arrays have the planned size from the start, so every step runs the programs of the first.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.acquisition import ACQUISITIONS, Acquisition, choose, sobol_candidates
from hsed_jax.design.discrepancy import discrepancy, variance_over
from hsed_jax.design.kriging import Kriging, condition, fit_kriging
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.maximum import Maximum, maximise
from hsed_jax.inference.nuts import Chains, Convergence, Settings, convergence, sample
from hsed_jax.inference.posterior import Posterior
from hsed_jax.physics.simulator import Conditions


@dataclass(frozen=True)
class DesignState:
    """All that the next step needs.

    Attributes:
        cube: asked inputs in the unit cube, planned size (N, d).
        conditions: SI inputs by name, each (N,).
        outputs: measured outputs, SI, (N, J); NaN where missing or not yet measured.
        count: how many experiments there are.
        theta: last MAP in unconstrained coordinates, a start of the next; None before the first.
        step_size: of NUTS, to go on from.
    """

    cube: np.ndarray
    conditions: dict[str, np.ndarray]
    outputs: np.ndarray
    count: int = 0
    theta: np.ndarray | None = None
    step_size: float = 0.8


class StepInfo(NamedTuple):
    """What one step found, for reports: nothing of it is needed to go on.

    Attributes:
        maximum: MAP, covariance, evidence.
        chains: the posterior's draws.
        convergence: whether to believe them.
        discrepancy: Eq. 12 at the tested inputs, (count,); NaN where the model diverged.
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
        relative, absolute: per output, the scale of the error: |measured| or 1 (`relative` is a (J,) mask).
        settings: of NUTS at each step.
        starts: of the MAP.
        candidates: size of the candidate set.
        acquisition: name of it.
        kriging: options of `fit_kriging`.
        variance_over_parameters: take the variance of Eq. 12 over the posterior of θ, too.
        seed: of the candidate set.
    """

    posterior: Posterior
    space: InputSpace
    size: int
    relative: np.ndarray
    settings: Settings
    starts: int
    candidates: int
    acquisition: str
    kriging: dict[str, Any]
    variance_over_parameters: bool
    seed: int

    def init(self) -> DesignState:
        """No experiment yet."""
        n, d, j = self.size, len(self.space.names), len(self.relative)
        # Padding repeats a valid input, so that padded simulations are harmless.
        middle = self.space.declared(np.full((n, d), 0.5))
        return DesignState(np.full((n, d), 0.5), self.space.si(middle), np.full((n, j), np.nan))

    def tell(self, state: DesignState, cube: Sequence[float], outputs: Sequence[float]) -> DesignState:
        """Add a measured experiment.

        Arguments:
            cube: its inputs in the unit cube, (d,).
            outputs: measured outputs, SI, (J,); NaN where missing.
        """
        if state.count >= self.size:
            raise ValueError(f"The design was planned for {self.size} experiments, and all of them are there.")
        i = state.count
        si = self.space.si(self.space.declared(np.asarray(cube)[None]))
        points, values = state.cube.copy(), state.outputs.copy()
        points[i], values[i] = cube, outputs
        conditions = {name: np.concatenate([x[:i], si[name], x[i + 1 :]]) for name, x in state.conditions.items()}
        return DesignState(points, conditions, values, i + 1, state.theta, state.step_size)

    def data(self, state: DesignState) -> Data:
        """The measured experiments, padded to the planned size."""
        measured = np.isfinite(state.outputs)
        values = np.where(measured, state.outputs, 1.0)
        scales = np.where(self.relative[None] & measured, np.abs(values), 1.0)
        conditions = Conditions({name: jnp.asarray(x) for name, x in state.conditions.items()})
        return Data(
            conditions, jnp.asarray(values), jnp.asarray(scales), jnp.asarray(measured, float), jnp.asarray(state.count)
        )

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
        of_nuts, of_kriging, of_choice = jax.random.split(key, 3)
        data = self.data(state)
        maximum = self.maximise(data, self.starting_points(state))
        chains = self._sample(data, maximum, jnp.asarray(state.step_size), of_nuts)
        norms = np.asarray(self._discrepancy(data, maximum.theta, chains.theta))
        surrogate = self._fit(state, norms, of_kriging)
        tested = (jnp.asarray(state.cube), jnp.asarray(np.arange(self.size) < state.count))
        best = choose(surrogate, self.candidate_set, *tested, "expected_improvement", of_choice)
        choice = best
        if acquisition is not None or self.acquisition != "expected_improvement":
            by = acquisition or ACQUISITIONS[self.acquisition]
            choice = choose(surrogate, self.candidate_set, *tested, by, of_choice)
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
        going_on = DesignState(
            state.cube, state.conditions, state.outputs, state.count, np.asarray(maximum.u), float(chains.step_size)
        )
        return chosen, going_on, info

    def _fit(self, state: DesignState, norms: np.ndarray, key: PRNGKeyArray) -> Kriging:
        mask = self._measured(state) & np.isfinite(norms)
        responses = jnp.asarray(np.where(mask, norms, 0.0))
        return fit_kriging(jnp.asarray(state.cube), responses, jnp.asarray(mask), key=key, **self.kriging)

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
            norms: discrepancies the step found, (count then,); NaN where the model diverged.
            lengths, nugget: hyper-parameters of its Kriging.
        """
        responses = np.full(self.size, np.nan)
        responses[: len(norms)] = norms
        mask = self._measured(state) & np.isfinite(responses)
        options = {name: value for name, value in self.kriging.items() if name != "starts"}
        return condition(
            jnp.asarray(state.cube),
            jnp.asarray(np.where(mask, responses, 0.0)),
            jnp.asarray(mask),
            jnp.asarray(lengths),
            jnp.asarray(nugget),
            **options,
        )

    def starting_points(self, state: DesignState) -> Float[Array, "s p"]:
        """Where the MAP starts: spread over the prior, and the last MAP instead of the first of them."""
        spread = self._starts
        return spread if state.theta is None else spread.at[0].set(jnp.asarray(state.theta))

    @cached_property
    def maximise(self):
        """`hsed_jax.inference.maximum.maximise` for this study, compiled."""
        return jax.jit(lambda data, starts: maximise(self.posterior, data, starts))

    @cached_property
    def _starts(self):
        return self.posterior.starts(self.starts)

    @cached_property
    def candidate_set(self):
        """Inputs to choose from, in the unit cube, (candidates, d)."""
        return sobol_candidates(self.candidates, len(self.space.names), self.seed)

    @cached_property
    def _sample(self):
        return jax.jit(lambda data, maximum, step, key: sample(self.posterior, data, maximum, step, key, self.settings))

    @cached_property
    def _discrepancy(self):
        over = Conditions(
            {k: jnp.asarray(x) for k, x in self.space.si(self.space.declared(self.space.spread(256))).items()}
        )
        predict, models, groups = self.posterior.predict, len(self.posterior.model_names), self.posterior.groups

        @jax.jit
        def compute(data, theta, draws):
            here, ok = predict(theta[:models], data.conditions, data.count)
            if self.variance_over_parameters:
                thetas = draws.reshape(-1, draws.shape[-1])[:: max(1, draws.shape[0] * draws.shape[1] // 16), :models]
                there, good = jax.vmap(lambda t: predict(t, over, jnp.asarray(256)))(thetas)
                variance = variance_over(there.reshape(-1, there.shape[-1]), good.ravel(), groups)
            else:
                variance = variance_over(*predict(theta[:models], over, jnp.asarray(256)), groups)
            # Where the model diverged there is no discrepancy, which is not the same as none.
            return jnp.where(ok > 0, discrepancy(data.values, here, variance, data.weights), jnp.nan)

        return compute
