"""The noise of the observed outputs: given by the study, declared by a campaign or a laboratory, or inferred."""

from collections.abc import Mapping, Sequence

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Error
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import Channel
from hsed_jax.physics.outputs import is_quantity, quantity
from hsed_jax.physics.pairs import Pair
from hsed_jax.sections import ErrorEntry, NoiseEntry, per_output


def errors_of(study: Study, outputs: Sequence[str], declared: Mapping[str, Channel], pair: Pair) -> tuple[Error, ...]:
    """The errors of the outputs.

    Arguments:
        study: has the errors, or leaves them to the declared noise.
        outputs: names of the observed outputs.
        declared: measured channels and quantities of the campaign or laboratory, by name.
        pair: that the specimen is measured in.

    Raises:
        UserError: an error of an unobserved output, or a relative error of a quantity that may be negative or zero.
    """
    given = per_output("error", study.error, list(outputs))
    errors: list[Error] = []
    for name in outputs:
        entry = given.get(name) or ErrorEntry(inflate=False)
        size = entry if entry.kinds else _declared(declared.get(name))
        # The error of a history may be as large as the history.  For a quantity, an error of a half is already large.
        unknown = Prior("half_normal", 0.3 if study.observe == "quantities" else 1.0)
        if entry.discrepancy:
            _check_discrepancy(study, name, size)
        told = unknown if size.unknown else float(size.relative or size.absolute or 0.0)
        errors.append(_error(name, told, size.absolute is None, entry, pair))
    return tuple(errors)


def _check_discrepancy(study: Study, name: str, size: NoiseEntry) -> None:
    """Refuse a discrepancy that cannot be learned.

    Raises:
        UserError: for quantities without inputs, for a population, or without a declared noise.
    """
    if getattr(study.model, "levels", {}):
        raise UserError(
            "error.discrepancy: it cannot be distinguished from the scatter between specimens (model.levels); use one of the two"
        )
    if study.observe == "quantities" and not study.inputs:
        raise UserError(
            "error.discrepancy: for quantities it is learned over the inputs, but the study has none; give them with their "
            "distributions, such as inputs: {V_P: {uniform: [1.5, 3.0], unit: m/s}}"
        )
    if size.unknown:
        raise UserError(
            f"error.discrepancy: no noise of {name} is declared, and with an unknown noise, noise and model cannot be "
            f"distinguished; give it, such as error: {{{name}: {{relative: 0.02, discrepancy: true}}}}"
        )


def _error(name: str, size: float | Prior, is_relative: bool, entry: ErrorEntry, pair: Pair) -> Error:
    """The error of an output.

    Raises:
        UserError: it is relative to a quantity that may be negative or zero.
    """
    if is_relative and is_quantity(name) and quantity(name).is_signed:
        raise UserError(
            f"error.{name}: {name} may be negative or zero, so its error cannot be relative; give an absolute error "
            f"[{pair.output(name).unit}], such as error: {{{name}: {{absolute: 0.001}}}}"
        )
    return Error(size, is_relative, entry.correlated, entry.inflate, entry.discrepancy, entry.of == "measured")


def _declared(channel: Channel | None) -> NoiseEntry:
    """The declared noise, or else an inferred one."""
    if channel is None or channel.noise is None or not (channel.noise.absolute or channel.noise.relative):
        return NoiseEntry(unknown=True)
    return NoiseEntry(absolute=channel.noise.absolute, relative=channel.noise.relative)
