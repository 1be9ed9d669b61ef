"""The pair in which a specimen was measured, from the declared units: rotation and moment, strain and stress, and so on."""

from collections.abc import Mapping
from itertools import combinations

from hsed_jax.errors import UserError
from hsed_jax.measurements.experiment import Channel
from hsed_jax.measurements.units import channel_dimension, measures, parse_unit, quantity_dimension
from hsed_jax.physics.outputs import is_quantity, output
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE, PAIRS, Pair

_ALLOWED = ", ".join(map(str, PAIRS))


def pair_of(declared: Mapping[str, Channel]) -> Pair:
    """Return the pair of the units of channels and quantities; elongation and force if none belongs to a specimen.

    Arguments:
        declared: Channels and quantities by where they are declared, such as `channels.force`.

    Raises:
        UserError: A unit that is of no pair, units of different pairs, or units that several pairs share; with names, units
            and what is allowed.
    """
    found = {where: pairs for where, channel in declared.items() if (pairs := _pairs(where, channel))}
    left = [pair for pair in PAIRS if all(pair in pairs for pairs in found.values())]
    if not left:
        one, other = _apart(found)
        raise UserError(
            f"{one} in {declared[one].unit!r} and {other} in {declared[other].unit!r} do not belong together; the pairs "
            f"that a specimen may be measured in are {_ALLOWED}"
        )
    if ELONGATION_AND_FORCE in left or len(left) == 1:
        return left[0]
    where = next(iter(found))
    raise UserError(
        f"{where} in {declared[where].unit!r} may be {' or '.join(f'a {pair.elongation}' for pair in left)}: the unit of the "
        f"force decides; declare force, as {' or '.join(f'a {pair.force} [{pair.force_unit}]' for pair in left)}"
    )


def _pairs(where: str, channel: Channel) -> list[Pair]:
    """The pairs that have a channel or quantity in its unit; empty if it does not belong to the specimen, or no pair
    has it.
    """
    name = channel.name
    try:
        if not output(name).gains:
            return []
    except KeyError:
        return []
    dimension_of = quantity_dimension if is_quantity(name) else channel_dimension
    found = [pair for pair in PAIRS if measures(channel.unit, dimension_of(name, pair))]
    if not found:
        try:
            parse_unit(channel.unit, dimension_of(name))
        except UserError as error:
            raise UserError(f"{where}: {error}; the pairs that a specimen may be measured in are {_ALLOWED}") from None
    return found


def _apart(found: Mapping[str, list[Pair]]) -> tuple[str, str]:
    """Two that have no pair in common; if any two have one, the first and the last."""
    for one, other in combinations(found, 2):
        if not set(found[one]) & set(found[other]):
            return one, other
    return next(iter(found)), list(found)[-1]


def check_masses(where: str, pair: Pair) -> None:
    """Refuse a pair that a structure with masses cannot have.

    Arguments:
        where: it is declared.
        pair: that the specimen is measured in.

    Raises:
        UserError: it is not elongation [m] and force [N].
    """
    if pair != ELONGATION_AND_FORCE:
        raise UserError(
            f"{where}: the specimen is measured in {pair}; in a shaken structure only {ELONGATION_AND_FORCE} are allowed, and "
            "another pair needs a test of the specimen alone (protocol: displacement)"
        )
