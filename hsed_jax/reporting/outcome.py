"""What a run has come to: everything its summary, results and figures are made from."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np

from hsed_jax.design.sequential import DesignState, SequentialDesign
from hsed_jax.inference.fit import Fit
from hsed_jax.inference.posterior import Posterior
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.physics.simulator import Simulator


@dataclass(frozen=True)
class Outcome:
    """State of a run.

    Attributes:
        study: its name.
        status: `complete` or `interrupted`.
        posterior: prior and likelihood of the model.
        simulator: of the model.
        laboratory: where experiments were performed.
        units: SI unit of each parameter.
        design: the sequential design, and its state, steps (as in the journal) and reason to stop, where it ran.
        fit: the final calibration, where it ran.
    """

    study: str
    status: str
    posterior: Posterior
    simulator: Simulator
    laboratory: VirtualLaboratory
    units: dict[str, str]
    design: SequentialDesign
    initial: int
    state: DesignState | None
    steps: list[dict[str, Any]]
    stop_reason: str
    fit: Fit | None

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the observed quantities."""
        return self.laboratory.quantities

    @cached_property
    def predicted(self) -> np.ndarray:
        """Quantities predicted at θ_MAP for the experiments so far, SI, (count, J)."""
        assert self.state is not None and self.fit is not None
        data = self.design.data(self.state)
        theta = self.fit.maximum.theta[: len(self.posterior.model_names)]
        values, _ = self.posterior.predict(theta, data.conditions, jnp.asarray(data.count))
        return np.asarray(values)[: self.state.count]

    @property
    def estimates(self) -> np.ndarray:
        """θ_MAP at every step and of the final calibration, SI, (steps + 1, p)."""
        rows = [[step["map"][name] for name in self.posterior.names] for step in self.steps]
        if self.fit is not None:
            rows.append([self.fit.map[name] for name in self.posterior.names])
        return np.asarray(rows).reshape(len(rows), len(self.posterior.names))

    def band(self, quantile: str) -> np.ndarray:
        """A posterior quantile (`q05`, `q95`) at every step and of the final calibration, SI, (steps + 1, p)."""
        summaries = [step["posterior"] for step in self.steps] + ([self.fit.summary()] if self.fit is not None else [])
        return np.asarray([[s[name][quantile] for name in self.posterior.names] for s in summaries])


def summary(outcome: Outcome) -> dict[str, Any]:
    """The content of `summary.json`."""
    content: dict[str, Any] = {"study": outcome.study, "status": outcome.status}
    fit, state = outcome.fit, outcome.state
    if fit is not None:
        content["calibration"] = {
            "map": fit.map,
            "posterior": fit.summary(),
            "divergences": fit.convergence.divergences,
            "log_evidence": float(fit.maximum.log_evidence),
        }
    if state is not None:
        estimates = outcome.estimates.T.tolist()
        content["design"] = {
            "inputs": outcome.design.space.declared(state.cube[: state.count]).tolist(),
            "max_expected_improvement": [step["max_expected_improvement"] for step in outcome.steps],
            "map": dict(zip(outcome.posterior.names, estimates, strict=False)),
            "stop_reason": outcome.stop_reason,
        }
    return content
