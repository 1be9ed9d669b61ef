"""The observed outputs of a study: quantities or channels that the campaign, the laboratory and the model have."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError, at
from hsed_jax.inference.likelihood import Error
from hsed_jax.laboratories.kinds.base import MeasuredEntry
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.models.function import is_output
from hsed_jax.physics.names import of_each, own_name, owner_of
from hsed_jax.physics.outputs import CHANNELS, PER_MASS, is_driver, quantity
from hsed_jax.physics.structures import Structure
from hsed_jax.plain import shown
from hsed_jax.study.experiments import Experiments
from hsed_jax.study.laboratories import driver_of, responses, sensors_of
from hsed_jax.study.mechanics import AbstractMechanics
from hsed_jax.study.noise import errors_of
from hsed_jax.study.structures import masses_of


@dataclass(frozen=True)
class Observed:
    """The observed outputs of a study.

    Attributes:
        study: of the user.
        experiments: that are observed.
        mechanics: of the model.
    """

    study: Study
    experiments: Experiments
    mechanics: AbstractMechanics

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        """Names of the observed quantities or channels.

        Raises:
            UserError: one is not measured, or the model does not give it.
        """
        study, measured, alone = self.study, self.experiments.measured, self.experiments.component_test
        if study.observe == "quantities":
            self._check(tuple(study.quantities))
            return tuple(study.quantities)
        if measured is None:
            known = _declared(study)
            default = ("force",) if alone else ("elongation", "force")
            owners = [element.name for element in self.mechanics.elements]
            names = tuple(study.channels or known or of_each(owners, default))
        else:
            known = responses(measured.channels, component_test=alone)
            names = tuple(study.channels or known)
        for name in names:
            if known is not None and name not in known:
                raise UserError(f"channels: {name} was not measured; measured are {', '.join(known) or 'none'}")
        self._check(names)
        if not names:
            raise UserError(
                "observe: there is no measured channel to compare with; the campaign has only imposed channels"
            )
        return names

    @cached_property
    def sensors(self) -> Sensors:
        """The sensors of the laboratory."""
        return sensors_of(self.study, self.outputs, self.mechanics.structure)

    @cached_property
    def errors(self) -> tuple[Error, ...]:
        """Properties of each output."""
        source = self.sensors if self.experiments.measured is None else self.experiments.measured
        declared = source.quantities if self.study.observe == "quantities" else source.channels
        return errors_of(self.study, self.outputs, declared, self.mechanics.pair)

    def _check(self, names: tuple[str, ...]) -> None:
        """Refuse quantities or channels that the model does not give, as far as its specimens tell.

        Raises:
            UserError: the model does not give one.
        """
        mechanics, experiments = self.mechanics, self.experiments
        histories = self.study.observe == "histories"
        if not mechanics.has_specimens:
            if histories and (unknown := [name for name in names if not is_output(name)]):
                known = [*(name for name in CHANNELS if not is_driver(name)), *(f"{kind}_1" for kind in PER_MASS)]
                raise UserError(
                    f"channels: there is no channel {shown(unknown[0])}; there are {', '.join(known)} and so on"
                )
            return
        owners = [element.name for element in mechanics.elements]
        if histories:
            for name in names:
                at("channels", _check_channel, name, mechanics.structure, owners)
            return
        # Shorter records are ignored.
        is_planned = not experiments.records and experiments.excitation is not None
        _check_quantities(names, mechanics.structure, owners, experiments.duration if is_planned else math.inf)


def _check_channel(name: str, structure: Structure | None, owners: Sequence[str]) -> None:
    """Refuse a channel that the model does not give.

    Arguments:
        name: of the channel.
        structure: that the specimens are in; None: the specimen is alone.
        owners: names of the specimens.

    Raises:
        UserError: there is no such channel, it is imposed, or it is of a mass that does not exist.
    """
    masses = range(1, masses_of(structure) + 1)
    # Without a structure it was imposed.
    imposed = () if masses else ("elongation",)
    kinds = [*(f"{kind}_{{}}" for kind in PER_MASS), "acceleration_{}_absolute"]
    given = [
        *of_each(owners, [name for name, known in CHANNELS.items() if known.of_specimen and name not in imposed]),
        *(kind.format(mass) for mass in masses for kind in kinds),
    ]
    if name not in given:
        raise UserError(f"there is no channel {shown(name)} that the model gives; it gives {', '.join(given)}")


def _check_quantities(
    names: Sequence[str], structure: Structure | None, owners: Sequence[str], duration: float
) -> None:
    """Refuse a quantity that the model does not give.

    Arguments:
        names: of the quantities.
        structure: that the specimens are in; None: the specimen is alone.
        owners: names of the specimens.
        duration: of the experiments [s].

    Raises:
        UserError: one belongs to an unknown specimen, to masses that do not exist, or to a time after the end.
    """
    for name in names:
        known = quantity(name)
        if known.of_specimen and owner_of(name) not in owners:
            each = ", ".join(of_each(owners, (own_name(name),)))
            raise UserError(f"quantities: there is no {name}; the structure has {each}")
        if not known.channels(masses_of(structure)):
            raise UserError(f"quantities: {name} needs masses, but a component test has none; leave it out")
        if known.until > duration:
            raise UserError(f"quantities: {name} lies beyond the end of the experiments, which last {duration:g} s")


def _declared(study: Study) -> tuple[str, ...] | None:
    """Channels of responses that the laboratory declares; None if it measures all requested outputs."""
    entry = study.experiments.laboratory
    if not isinstance(entry, MeasuredEntry) or not entry.channels:
        return None
    return responses(entry.channels, component_test=driver_of(study) == "elongation")
