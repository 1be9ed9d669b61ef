"""The excitation of the experiments of a study, and the sensors of its laboratory."""

from collections.abc import Iterable

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.laboratories.kinds.base import Wanted
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.physics.outputs import is_driver, quantity
from hsed_jax.physics.structures import Structure
from hsed_jax.study import structures


def responses(channels: Iterable[str], *, component_test: bool) -> tuple[str, ...]:
    """The channels that are a response to the excitation."""
    return tuple(name for name in channels if not (is_driver(name) or (component_test and name == "elongation")))


def driver_of(study: Study) -> str:
    """The channel that measures the excitation of the planned experiments of a study."""
    return "ground_acceleration" if study.excitation is None else study.excitation.channel


def sensors_of(study: Study, outputs: tuple[str, ...], structure: Structure | None) -> Sensors:
    """The sensors of the laboratory of a study.

    Arguments:
        study: the study.
        outputs: the quantities or channels that it observes.
        structure: that the specimen is in.

    Raises:
        UserError: a channel or unit is unknown, or an observed output is not measured.
    """
    entry = study.experiments.laboratory
    if entry is None:
        raise UserError("experiments: there is no laboratory")
    channels, quantities = (outputs, ()) if study.observe == "histories" else ((), outputs)
    sources = {name: quantity(name).channels(structures.masses_of(structure)) for name in quantities}
    return entry.sensors(
        Wanted(f"experiments.{study.experiments.kind}", channels, quantities, sources, driver_of(study))
    )
