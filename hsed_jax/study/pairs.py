"""The pair that a study's specimen is measured in, as whoever measures it declares."""

from typing import TYPE_CHECKING

from hsed_jax.config.experiments import MeasuredEntry
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, pair_of
from hsed_jax.measurements.declaration import declared_channel
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE, Pair

if TYPE_CHECKING:
    from hsed_jax.study.build import Built


def study_pair(built: "Built") -> Pair:
    """The pair of the measured campaign, or of what the laboratory declares; elongation and force where neither says.

    Raises:
        UserError: units that do not belong together; or the specimen is in a structure of masses, and the pair is another.
    """
    if built.measured is not None:
        pair, where = built.measured.pair, f"the campaign {built.measured.name!r}"
    else:
        entry, where = built.study.experiments.laboratory, f"experiments.{built.study.experiments.kind}"
        given = {"channels": entry.channels, "quantities": entry.quantities} if isinstance(entry, MeasuredEntry) else {}
        pair = pair_of(
            {
                f"{where}.{kind}.{name}": declared_channel(f"{where}.{kind}.{name}", name, channel)
                for kind, declared in given.items()
                for name, channel in declared.items()
            }
        )
    if built.structure is not None:
        check_masses(where, pair)
    return pair


def check_masses(where: str, pair: Pair) -> None:
    """Refuse a pair that no structure of masses has.

    Arguments:
        where: it is declared.
        pair: that the specimen is measured in.

    Raises:
        UserError: it is not elongation [m] and force [N].
    """
    if pair != ELONGATION_AND_FORCE:
        raise UserError(
            f"{where}: the specimen is measured in {pair}; between masses that are shaken only {ELONGATION_AND_FORCE} make "
            "sense, another pair needs a test of the specimen alone (protocol: displacement)"
        )


def check_same(campaign: Campaign, pair: Pair) -> None:
    """Refuse measurements in another pair than that of the model they are compared with.

    Arguments:
        campaign: the measurements.
        pair: of the study.

    Raises:
        UserError: they are in another one.
    """
    if campaign.pair != pair:
        raise UserError(f"the campaign {campaign.name!r} is measured in {campaign.pair}; the study is of {pair}")
