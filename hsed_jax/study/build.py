"""From the user's study to the objects that compute: the numerics get no `None`."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from hsed_jax.backend import prepare
from hsed_jax.config.functions import FunctionEntry
from hsed_jax.config.opensees import OpenSeesEntry
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign
from hsed_jax.study import parts
from hsed_jax.study.called_study import CalledMechanics, CalledSimulation
from hsed_jax.study.design import Design
from hsed_jax.study.experiments import Experiments
from hsed_jax.study.function_study import FunctionMechanics, FunctionSimulation
from hsed_jax.study.inference import Inference
from hsed_jax.study.mechanics import AbstractMechanics, SpringMechanics
from hsed_jax.study.observed import Observed
from hsed_jax.study.opensees_study import OpenSeesMechanics, OpenSeesSimulation
from hsed_jax.study.plan import check_plan
from hsed_jax.study.simulation import AbstractSimulation, SpringSimulation
from hsed_jax.study.site import Site


class _Called(NamedTuple):
    """Classes that build a called model."""

    mechanics: type[CalledMechanics]
    simulation: type[CalledSimulation]


_CALLED: dict[type[Any], _Called] = {
    FunctionEntry: _Called(FunctionMechanics, FunctionSimulation),
    OpenSeesEntry: _Called(OpenSeesMechanics, OpenSeesSimulation),
}
"""Kinds of called models by the key of a study; other models have spring laws."""


@dataclass(frozen=True)
class Built:
    """The products of a study; each product and each of its parts is built at its first use.

    Attributes:
        study: of the user.
        campaign: measured experiments; by default the campaign that the study names.
        workspace: folder in which the laboratory has its folders; by default a temporary one.
        function: the laboratory, if it is a Python function.
        open_forms: effects with free parameters of their forms, for a model that contains all forms.

    Raises:
        UserError: it is not a study, but for example its file.
    """

    study: Study
    campaign: Campaign | None = None
    workspace: Path | None = None
    function: Callable[..., Any] | None = None
    open_forms: tuple[str, ...] = ()

    def __post_init__(self):
        # In a notebook no earlier code checks the type.
        if not isinstance(self.study, Study):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise UserError(
                f"study: {self.study!r} is not a study; hx.load_study('study.yaml') reads one from its file"
            )
        prepare()

    @cached_property
    def experiments(self) -> Experiments:
        """The experiments, measured or planned."""
        return Experiments(self.study, self.campaign)

    @cached_property
    def mechanics(self) -> AbstractMechanics:
        """The parts of the model."""
        if (called := _CALLED.get(type(self.study.model))) is not None:
            return called.mechanics(self.study, self.experiments)
        return SpringMechanics(self.study, self.experiments, self.open_forms)

    @cached_property
    def observed(self) -> Observed:
        """The observed outputs and their errors."""
        return Observed(self.study, self.experiments, self.mechanics)

    @cached_property
    def simulation(self) -> AbstractSimulation:
        """How the experiments are simulated."""
        called = _CALLED.get(type(self.study.model))
        kind = SpringSimulation if called is None else called.simulation
        return kind(self.study, self.experiments, self.mechanics, self.observed)

    @cached_property
    def inference(self) -> Inference:
        """The inference from the experiments."""
        return Inference(self.study, self.experiments, self.mechanics, self.observed, self.simulation)

    @cached_property
    def design(self) -> Design:
        """The design of further experiments."""
        return Design(self.study, self.inference)

    @cached_property
    def site(self) -> Site:
        """The place where experiments are performed."""
        products = self.study, self.experiments, self.mechanics, self.observed, self.simulation
        return Site(*products, self.workspace, self.function)

    def check(self, *, performs: bool = True) -> None:
        """Build everything that can have faults, and compute nothing; a `UserError` names the fault.

        `performs` states whether the laboratory will perform experiments; otherwise it is not built, because it may be code.
        """
        try:
            check_plan(self.study, self.experiments.space)
            self.mechanics.check()
            self.study.measurements.accepted(self.experiments.measured)
            for product, part in self._needed(performs):
                getattr(product, part)
            self.inference.check_told()
        except UserError as error:
            raise parts.in_study(self.study.file, error) from None

    def _needed(self, performs: bool) -> list[tuple[Any, str]]:
        """The parts that a check builds.

        A check of spring laws builds no simulator, and no virtual specimen, whose scales may need a simulation.
        """
        study, mechanics = self.study, self.mechanics
        needed = [
            (mechanics, "pair"),
            (mechanics, "structure"),
            (mechanics, "parameters"),
            (self.experiments, "excitation"),
            (self.observed, "outputs"),
            (self.simulation, "timeline"),
            (self.observed, "errors"),
            (self.inference, "levels"),
        ]
        if study.experiments.laboratory is not None or "design" in study.steps:
            needed += [(self.observed, "sensors"), (self.site, "programme")]
            if study.experiments.specimen is not None:
                needed.append((mechanics, "virtual"))
            elif performs:
                needed.append((self.site, "laboratory"))
        if type(study.model) in _CALLED:
            needed += [(mechanics, "units"), (self.simulation, "simulator"), (self.design, "limits")]
        return needed
