"""What a study observes: the names of its quantities or channels, as campaign, laboratory and model can give them."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hsed_jax.config.experiments import MeasuredEntry
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.physics.names import of_each, own_name, owner_of
from hsed_jax.physics.outputs import CHANNELS, PER_MASS, quantity
from hsed_jax.physics.structures import Structure
from hsed_jax.plain import shown
from hsed_jax.study import parts
from hsed_jax.study.laboratories import driver_of, responses
from hsed_jax.study.structures import masses_of
from hsed_jax.study.timelines import duration_of

if TYPE_CHECKING:
    from hsed_jax.study.build import Built


def outputs_of(built: "Built") -> tuple[str, ...]:
    """Names of the observed quantities or channels.

    Raises:
        UserError: one is not measured, or is none that the model gives.
    """
    study, measured = built.study, built.measured
    if study.observe == "quantities":
        built.check_outputs(tuple(study.quantities))
        return tuple(study.quantities)
    if measured is None:
        known = _declared(study)
        default = ("force",) if built.component_test else ("elongation", "force")
        names = tuple(study.channels or known or of_each([element.name for element in built.elements], default))
    else:
        known = responses(measured.channels, component_test=built.component_test)
        names = tuple(study.channels or known)
    for name in names:
        if known is not None and name not in known:
            raise UserError(f"channels: {name} was not measured; measured are {', '.join(known) or 'none'}")
    built.check_outputs(names)
    if not names:
        raise UserError("observe: there is no measured channel to compare with; the campaign has only what was imposed")
    return names


def check_outputs(built: "Built", names: tuple[str, ...]) -> None:
    """Refuse quantities or channels, whichever a study observes, that its specimens and their structure do not have.

    Raises:
        UserError: one is none of theirs.
    """
    structure, owners = built.structure, [element.name for element in built.elements]
    if built.study.observe == "quantities":
        # A record that ends before is passed over.
        duration = duration_of(built) if built.grid is None and built.excitation is not None else math.inf
        _check_quantities(names, structure, owners, duration)
        return
    for name in names:
        parts.at("channels", _check_channel, name, structure, owners)


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
        UserError: one is of no specimen that there is, or of masses, and there are none, or of a time after the end.
    """
    for name in names:
        known = quantity(name)
        if known.of_specimen and owner_of(name) not in owners:
            each = ", ".join(of_each(owners, (own_name(name),)))
            raise UserError(f"quantities: there is no {name}; the structure has {each}")
        if not known.channels(masses_of(structure)):
            raise UserError(f"quantities: {name} is one of masses, and a component test has none; leave it out")
        if known.until > duration:
            raise UserError(f"quantities: {name} lies beyond the end of the experiments, which last {duration:g} s")


def _declared(study: Study) -> tuple[str, ...] | None:
    """Channels of responses that the laboratory declares; None where it measures what it is asked for."""
    entry = study.experiments.laboratory
    if not isinstance(entry, MeasuredEntry) or not entry.channels:
        return None
    return responses(entry.channels, component_test=driver_of(study) == "elongation")
