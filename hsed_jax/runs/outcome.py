"""The outcome of a run, from which its summary, results and figures are made."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hsed_jax.analysis.remainder import WithRemainder
from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.improve import Trail
from hsed_jax.criticism.locate import Location
from hsed_jax.design.drift import Drift
from hsed_jax.design.sequential import DesignState, SequentialDesign
from hsed_jax.design.space import InputSpace
from hsed_jax.design.teaching import told
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.discovery.findings import Discovery
from hsed_jax.inference.fit import Fit
from hsed_jax.inference.posterior import Posterior
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.measurements import Campaign
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import AbstractModel


@dataclass(frozen=True)
class Outcome:
    """State of a run.

    Attributes:
        study: its name.
        status: `complete` or `interrupted`.
        posterior: prior and likelihood of the model.
        model: the computational model.
        catalogue: the effects that the study knows.
        laboratory: the virtual laboratory, where there is one.
        units: SI unit of each parameter.
        campaign: the experiments.
        space: of the inputs.
        design: the sequential design, and its state, steps (as in the journal) and reason to stop, where it ran.
        drift: the difference between its estimates and those over all inputs; None before its end.
        fit, comparison, location, diagnosis: results of the steps that ran.
        remaining: where the model with the named effects still fails.
        improved_location: where the improved model does.
        discovery: the learned effect that is not in the catalogue.
        trail, improved, improved_comparison: the fall of the error, the improved model, and how far it is from the
            measurements.
        remainder: the last model with what it leaves, as a function of the path; None if it was not learned.
        scales: characteristic values that amplitudes of effects are relative to; None without effects.
    """

    study: str
    status: str
    posterior: Posterior
    model: AbstractModel
    catalogue: Catalogue
    laboratory: VirtualLaboratory | None
    units: dict[str, str]
    campaign: Campaign
    space: InputSpace
    design: SequentialDesign | None
    initial: int
    state: DesignState | None
    steps: list[dict[str, Any]]
    stop_reason: str
    drift: Drift | None
    fit: Fit | None
    comparison: Comparison | None
    location: Location | None
    diagnosis: Diagnosis | None
    remaining: Location | None
    discovery: Discovery | None
    trail: Trail | None
    improved: Fit | None
    improved_comparison: Comparison | None
    improved_location: Location | None
    remainder: WithRemainder | None
    scales: Scales | None

    @property
    def truth(self) -> Mapping[str, float]:
        """The parameters of the virtual specimen, SI; empty without one."""
        return {} if self.laboratory is None else self.laboratory.parameters

    @property
    def improvements(self) -> list[float]:
        """The displayed largest expected improvement of every step of the design."""
        return told([step["max_expected_improvement"] for step in self.steps])

    @property
    def estimates(self) -> np.ndarray:
        """θ_MAP at every step and of the final calibration, SI, (steps + 1, p)."""
        names = self.posterior.reported
        rows = [[step["map"][name] for name in names] for step in self.steps]
        if self.fit is not None:
            rows.append([self.fit.map[name] for name in names])
        return np.asarray(rows).reshape(len(rows), len(names))

    def band(self, quantile: str) -> np.ndarray:
        """A posterior quantile (`q05`, `q95`) at every step and of the final calibration, SI, (steps + 1, p)."""
        summaries = [step["posterior"] for step in self.steps] + ([self.fit.summary()] if self.fit is not None else [])
        return np.asarray([[s[name][quantile] for name in self.posterior.reported] for s in summaries])


def summary(outcome: Outcome) -> dict[str, Any]:
    """The content of `summary.json`."""
    content: dict[str, Any] = {"study": outcome.study, "status": outcome.status}
    fit, state = outcome.fit, outcome.state
    if outcome.scales is not None:
        content["scales"] = {name: float(value) for name, value in outcome.scales._asdict().items()}
    if fit is not None:
        content["calibration"] = (
            {
                "map": fit.map,
                "posterior": fit.summary(),
                "divergences": fit.convergence.divergences,
                "log_evidence": float(fit.maximum.log_evidence),
            }
            | _levels(fit)
            | _doubts(fit)
        )
    if outcome.comparison is not None:
        content["comparison"] = outcome.comparison.summary()
    if outcome.location is not None and "comparison" in content:
        content["comparison"]["where"] = outcome.location.summary()
    if outcome.diagnosis is not None:
        content["diagnosis"] = outcome.diagnosis.summary()
        if outcome.remaining is not None:
            content["diagnosis"]["remaining"] = outcome.remaining.summary()
    if outcome.discovery is not None:
        content["discovery"] = outcome.discovery.summary()
    if outcome.trail is not None:
        content["improvement"] = outcome.trail.summary()
        if outcome.improved is not None and outcome.improved_comparison is not None:
            content["improvement"] |= (
                {
                    "map": outcome.improved.map,
                    "posterior": outcome.improved.summary(),
                    "divergences": outcome.improved.convergence.divergences,
                    "comparison": outcome.improved_comparison.summary(),
                }
                | _levels(outcome.improved)
                | _doubts(outcome.improved)
            )
            if outcome.improved_location is not None:
                content["improvement"]["comparison"]["where"] = outcome.improved_location.summary()
        if outcome.remainder is not None:
            content["improvement"]["remainder"] = outcome.remainder.summary()
    if state is not None:
        assert outcome.design is not None
        estimates = outcome.estimates.T.tolist()
        content["design"] = {
            "inputs": outcome.design.space.declared(state.cube).tolist(),
            "max_expected_improvement": outcome.improvements,
            "map": dict(zip(outcome.posterior.names, estimates, strict=False)),
            "stop_reason": outcome.stop_reason,
        } | _drift(outcome)
    # A report is drawn from the written files: it must not execute law and effects, which may be somebody else's code.
    content["references"] = _references(outcome)
    return content


def _references(outcome: Outcome) -> dict[str, str]:
    """References of the model, of the named effects and of the added ones, by name."""
    named = [] if outcome.diagnosis is None else outcome.diagnosis.effects
    used = named + (
        [] if outcome.trail is None else [effect for step in outcome.trail.steps for effect in step.effects]
    )
    return outcome.model.references | {name: outcome.catalogue[name].reference for name in dict.fromkeys(used)}


def _drift(outcome: Outcome) -> dict[str, Any]:
    """The estimates over all inputs, and the warning about them, after the end of a design."""
    if outcome.drift is None:
        return {}
    said = outcome.drift.sentence(outcome.units)
    return {"map_over_inputs": outcome.drift.over_inputs} | ({} if said is None else {"drift": said})


def _levels(fit: Fit) -> dict[str, Any]:
    """The parameters that vary between specimens, if any."""
    found = fit.levels()
    return {"levels": found} if found else {}


def _doubts(fit: Fit) -> dict[str, Any]:
    """Estimates on bounds, faults of the draws, and the residual of the model, as far as they are known."""
    said = {
        "caution": fit.caution,
        "at_bounds": [one.summary() for one in fit.leaning] or None,
        "warning": fit.warning,
        "chi2_per_datum": fit.chi2_per_datum,
        "doubt": fit.doubt,
        "disagreement": None if fit.disagreement is None else fit.disagreement.summary(),
    }
    return {key: value for key, value in said.items() if value is not None} | (
        {} if fit.discrepancy is None else {"discrepancy": fit.discrepancy_summary()}
    )
