"""The mechanics of a study: specimens with their laws and effects, the structure that they are in, and the parameters of both."""

# A cached property implements an abstract property here.
# pyright: reportIncompatibleMethodOverride=false

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from hsed_jax.config.mechanics import ModelEntry
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.laboratories.kinds.base import MeasuredEntry
from hsed_jax.measurements import pair_of
from hsed_jax.measurements.declaration import declared_channel
from hsed_jax.measurements.pairs import check_masses
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.names import OWNER
from hsed_jax.physics.pairs import Pair
from hsed_jax.physics.parameters import Parameter
from hsed_jax.physics.structures import Structure
from hsed_jax.study import structures
from hsed_jax.study.elements import elements_of, placed
from hsed_jax.study.experiments import Experiments
from hsed_jax.study.own_parts import catalogue_of, law_of
from hsed_jax.study.plan import check_added
from hsed_jax.study.specimens import Naming


class Virtual(NamedTuple):
    """Specimens that a virtual laboratory tests.

    Attributes:
        elements: the specimens; specimens that share the law of the model may have another law here.
        parameters: their true parameters, and those of the structure, SI.
    """

    elements: tuple[Element, ...]
    parameters: dict[str, float]


@dataclass(frozen=True)
class AbstractMechanics(ABC):
    """The parts of a model; each kind of model has its own.

    Attributes:
        study: of the user.
        experiments: of the model.
    """

    study: Study
    experiments: Experiments

    @property
    @abstractmethod
    def elements(self) -> tuple[Element, ...]:
        """The specimens; files of own laws are executed."""

    @property
    @abstractmethod
    def naming(self) -> Naming:
        """The meaning of the names of parameters and effects.

        Raises:
            UserError: the model is a function, and has its own names.
        """

    @property
    @abstractmethod
    def structure(self) -> Structure | None:
        """The numerical substructure; None for a component test."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Free parameters of the model with their priors, and the fixed ones with their values."""

    @property
    @abstractmethod
    def units(self) -> dict[str, str]:
        """SI unit of every free parameter."""

    @property
    @abstractmethod
    def laws(self) -> tuple[AbstractSpringLaw, ...]:
        """The laws in the middle of their priors; none for a model without a law."""

    @property
    @abstractmethod
    def steepest(self) -> tuple[AbstractSpringLaw, ...]:
        """The laws at the parameters where they are stiffest and yield first, within the priors."""

    @property
    @abstractmethod
    def has_specimens(self) -> bool:
        """Whether structure and specimens determine the outputs; the outputs of a function are known only after a call."""

    @abstractmethod
    def known(self, name: str) -> Parameter | None:
        """The declaration of a parameter of the model; None if only the user knows the parameter."""

    @property
    def is_shared(self) -> bool:
        """Whether its program takes long to compile, because it holds all forms of its effects."""
        return False

    @abstractmethod
    def check(self) -> None:
        """Refuse effects that the model cannot have, and steps that need effects if it can have none."""

    @cached_property
    def catalogue(self) -> Catalogue:
        """The effects that the study may name; its own files of effects are executed."""
        springs = [] if self.study.structure is None else self.study.structure.springs
        # The campaign may be needed to find the excitation, but a study without springs has a catalogue without it.
        count = len(springs) if springs and not self.experiments.component_test else 0
        return placed(catalogue_of(self.study), self.elements, count)

    @cached_property
    def pair(self) -> Pair:
        """The kind of elongation and force of the specimen, as the campaign or the laboratory declares it; otherwise
        elongation and force.

        Raises:
            UserError: units that do not belong together; or the specimen is in a structure of masses, and the pair is another.
        """
        if (measured := self.experiments.measured) is not None:
            pair, where = measured.pair, f"the campaign {measured.name!r}"
        else:
            entry, where = self.study.experiments.laboratory, f"experiments.{self.study.experiments.kind}"
            given = (
                {"channels": entry.channels, "quantities": entry.quantities} if isinstance(entry, MeasuredEntry) else {}
            )
            pair = pair_of(
                {
                    f"{where}.{kind}.{name}": declared_channel(f"{where}.{kind}.{name}", name, channel)
                    for kind, declared in given.items()
                    for name, channel in declared.items()
                }
            )
        if self.structure is not None:
            check_masses(where, pair)
        return pair

    @cached_property
    def structure_priors(self) -> dict[str, Prior]:
        """Priors of the structure's numbers that are calibrated."""
        entry = self.study.structure
        return {} if entry is None or self.experiments.component_test else structures.priors_of(entry)

    @property
    def stiffest(self) -> Structure:
        """The structure with its shortest period, within the priors."""
        return structures.stiffest(self.structure, self.structure_priors)

    @cached_property
    def virtual(self) -> Virtual:
        """The virtual specimens."""
        entry = self.study.experiments.specimen
        assert entry is not None
        elements = self.elements
        if entry.spring is not None:
            law = law_of("experiments.virtual.spring", entry.spring, self.study.folder)
            elements = tuple(e if e.is_apart else e._replace(law=law) for e in elements)
        told = structures.true_numbers("experiments.virtual.structure", entry.structure, self.structure_priors)
        of_structure = {f"{OWNER}.{name}": value for name, value in told.items()}
        return Virtual(elements, Naming(elements, self.catalogue).true_parameters(self.study) | of_structure)

    def _described_structure(self) -> Structure | None:
        if self.experiments.component_test:
            return None
        if self.study.structure is None:
            raise UserError(
                "structure: this key is required, unless the elongation was imposed (protocol: displacement)"
            )
        return structures.structure(self.study.structure)


@dataclass(frozen=True)
class SpringMechanics(AbstractMechanics):
    """A model of spring laws with effects.

    Attributes:
        open_forms: effects with free parameters of their forms, for a model that contains all forms.
    """

    open_forms: tuple[str, ...] = ()

    @property
    def is_shared(self) -> bool:
        """Whether any effect is present in all its forms."""
        return bool(self.open_forms)

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The specimens of the model; the files of own laws are executed."""
        assert isinstance(self.study.model, ModelEntry)
        return elements_of(self.study, law_of("model.spring", self.study.model.spring, self.study.folder))

    @cached_property
    def naming(self) -> Naming:
        """The meaning of the names of parameters and effects."""
        return Naming(self.elements, self.catalogue)

    @cached_property
    def structure(self) -> Structure | None:
        """The numerical substructure; None for a component test."""
        return self._described_structure()

    @cached_property
    def parameters(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Free parameters of the model with their priors, and the fixed ones with their values."""
        return self.naming.model_parameters(self.study, self.structure_priors, self.pair, self.open_forms)

    @cached_property
    def units(self) -> dict[str, str]:
        """SI unit of every free parameter."""
        free, fixed = self.parameters
        return self.naming.units(tuple(free), fixed, self.pair)

    @cached_property
    def laws(self) -> tuple[AbstractSpringLaw, ...]:
        """The laws in the middle of their priors."""
        return self.naming.laws(self.parameters)

    @cached_property
    def steepest(self) -> tuple[AbstractSpringLaw, ...]:
        """The laws at the parameters where they are stiffest and yield first, within the priors."""
        return self.naming.laws(self.parameters, steepest=True)

    def known(self, name: str) -> Parameter | None:
        """The declaration of a parameter of a law, an effect or the structure."""
        return self.naming.known(name)

    @property
    def has_specimens(self) -> bool:
        """True: the specimens determine the outputs."""
        return True

    def check(self) -> None:
        """Refuse effects that cannot be added to the model."""
        check_added(self.study, self.study.improve.add or [], self.naming, "improve.add: ")
