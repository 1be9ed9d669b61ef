"""A calibrated model for export: from a run folder, without executing its code, or from the result of `hx.calibrate`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hsed_jax.analysis.calibration import Calibration
from hsed_jax.analysis.remedy import Improvement
from hsed_jax.config.functions import FunctionEntry
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import Campaign
from hsed_jax.physics.effects.base import AbstractSetupEffect, AbstractSpringEffect
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws.base import AbstractSpringLaw
from hsed_jax.physics.names import by_owner, owner_of
from hsed_jax.physics.parameters import Parameter, dimensionless, parameters_of
from hsed_jax.physics.scales import Scales
from hsed_jax.runs.reading import read_run
from hsed_jax.study.build import Built


@dataclass(frozen=True)
class Calibrated:
    """A calibrated model.

    Attributes:
        built: the study; for a run, its simulator is never built.
        map: θ_MAP, SI.
        posterior: `mean`, `q05` and `q95` by name, SI.
        scales: characteristic values of effects; not used for a model without effects.
    """

    built: Built
    map: Mapping[str, float]
    posterior: Mapping[str, Mapping[str, float]]
    scales: Scales

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.built.study.study

    @property
    def priors(self) -> dict[str, Prior]:
        """Priors of the free parameters."""
        return self.built.mechanics.parameters[0]

    def known(self, name: str) -> Parameter | None:
        """The declaration of a parameter of a law, an effect or the structure; None for another one."""
        return self.built.mechanics.known(name)

    def of(self, element: Element) -> tuple[AbstractSpringLaw, dict[str, AbstractSpringEffect], list[str]]:
        """The law of a specimen at θ_MAP, the effects in it, and the names of effects outside it.

        Raises:
            UserError: a parameter of the law varies from experiment to experiment.
        """
        owners = by_owner({**self.built.mechanics.parameters[1], **self.map})
        values = {name: float(value) for name, value in element.parameters(owners).items()}
        for name, known in parameters_of(element.law).items():
            if name not in values and known.neutral is None:
                raise UserError(
                    f"{name} varies with a column of experiments.csv (model.levels): there is no single law to export"
                )
        effects, outside = {}, []
        for name, given in owners.items():
            effect = self.built.mechanics.catalogue.get(name)
            if effect is None:
                continue
            if issubclass(effect, AbstractSetupEffect):
                outside.append(name)
            elif issubclass(effect, AbstractSpringEffect) and element.has(owner_of(name)):
                own: dict[str, Any] = {}
                for key, value in given.items():
                    own |= dimensionless(effect, key, float(value), self.scales)
                effects[name] = effect(**own)
        return element.law(**values), effects, outside

    def reach(self) -> float:
        """The largest measured elongation [m], or the characteristic one."""
        measured = [] if self.built.experiments.measured is None else _elongations(self.built.experiments.measured)
        return max(measured, default=float(self.scales.elongation))


def calibrated(source: "str | Path | Calibration | Improvement", *, before: bool = False) -> Calibrated:
    """The model to export.

    Arguments:
        source: a run folder, or a result of `hx.calibrate` or `hx.improve`.
        before: export the first model of an improved run, or of an improvement.

    Raises:
        UserError: there is no run or no calibration in it, or its model is the user's code.
    """
    if isinstance(source, Improvement):
        source = source.original if before else source.calibration
    if isinstance(source, Calibration):
        _require_law(source.built, "the model")
        return Calibrated(source.built, source.map, source.fit.summary(), source.built.simulation.scales)
    run = read_run(source)
    improved = not before and "map" in run.summary.get("improvement", {})
    found = run.summary.get("improvement" if improved else "calibration", {})
    if "map" not in found:
        raise UserError(
            f"{source}: the run has no calibration; add the step calibrate (steps: [calibrate]) and run it again"
        )
    study = load_study(run.folder / ("improved.yaml" if improved else "study.yaml"))
    if study.code:
        raise UserError(
            f"{source}: its model is the user's code ({', '.join(study.code)}), which has no counterpart in OpenSees and "
            "which an export does not execute; in Python, hx.export(fit) makes the table of a model that you calibrate there"
        )
    built = Built(study, run.campaign)
    _require_law(built, str(source))
    return Calibrated(built, found["map"], found["posterior"], Scales(**run.summary.get("scales", {})))


def _require_law(built: Built, where: str) -> None:
    if isinstance(built.study.model, FunctionEntry):
        raise UserError(f"{where}: its model is a function or a program, which has no spring law to export")


def _elongations(campaign: Campaign) -> list[float]:
    """The largest elongations of experiments, by their records or quantities [m]."""
    records = [e.record["elongation"] for e in campaign.experiments if e.record and "elongation" in e.record.channels]
    found = [float(np.nanmax(np.abs(values))) for values in records]
    found += [e.quantities["peak_elongation"] for e in campaign.experiments if "peak_elongation" in e.quantities]
    return [value for value in found if value > 0]
