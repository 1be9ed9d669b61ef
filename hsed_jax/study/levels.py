"""Levels of a study: the columns of the experiments by which parameters vary, and their members."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.inference.leaning import ANYTHING, Range
from hsed_jax.inference.population import Level, Varying
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import Campaign, Experiment
from hsed_jax.plain import shown
from hsed_jax.study import parts

# Prior of a spread, a half-normal: of the logarithm, or in standard deviations of the parameter's own prior.
_SPREAD = 0.3


def levels_of(
    said: Mapping[str, Mapping[str, Mapping[str, Any]]],
    campaign: Campaign | None,
    free: Mapping[str, Prior],
    possible: Callable[[], Mapping[str, Range]],
) -> tuple[Level, ...]:
    """The levels of a study, their members those of the training experiments.

    Arguments:
        said: entries of the study, by column and parameter.
        campaign: of measurements.
        free: parameters of the model with their priors.
        possible: gives the physically possible range of each.

    Raises:
        UserError: there is no measured campaign or no such column, a cell of it is empty, or a parameter cannot vary.
    """
    if not said:
        return ()
    if campaign is None:
        raise UserError(
            "model.levels: a column of experiments.csv gives the members, but this study has no campaign of measurements; "
            "leave the levels out, or give experiments.campaign"
        )
    found: list[Level] = []
    for column, entries in said.items():
        where = f"model.levels.{column}"
        members = tuple(dict.fromkeys(member_of(e, column, campaign) for e in campaign.train))
        if len(members) < 2:
            only = f"only {members[0]!r}" if members else "no experiment"
            raise UserError(f"{where}: a level needs at least two members, and the training experiments have {only}")
        varying = [_varying(f"{where}.{name}", name, entry, free, possible) for name, entry in entries.items()]
        found.append(Level(column, members, tuple(varying)))
    return tuple(found)


def member_of(experiment: Experiment, column: str, campaign: Campaign) -> str:
    """The value of a column for an experiment.

    Raises:
        UserError: there is no such column, or its cell is empty.
    """
    value = experiment.id if column == "id" else experiment.metadata.get(column)
    if value is None:
        known = ["id", *dict.fromkeys(name for e in campaign for name in e.metadata)]
        if column not in known:
            raise UserError(
                f"model.levels.{column}: experiments.csv has no such column; it has {', '.join(known)} to distinguish specimens"
            )
        raise UserError(f"model.levels.{column}: experiment {experiment.id!r} has no {column}; fill its cell")
    return value


def members_of(levels: Sequence[Level], campaign: Campaign, experiments: Sequence[Experiment], size: int) -> np.ndarray:
    """The member of each experiment at each level, padded to `size` rows; members of no level come after all others."""
    table = np.zeros((size, len(levels)), dtype=int)
    for column, level in enumerate(levels):
        known = {member: number for number, member in enumerate(level.members)}
        for row, experiment in enumerate(experiments):
            member = member_of(experiment, level.name, campaign)
            table[row, column] = known.setdefault(member, len(known))
    return table


def _varying(
    where: str,
    name: str,
    entry: Mapping[str, Any],
    free: Mapping[str, Prior],
    possible: Callable[[], Mapping[str, Range]],
) -> Varying:
    if name not in free:
        raise UserError(f"{where}: {shown(name)} is not a calibrated parameter; those are {', '.join(free)}")
    prior = free[name]
    is_log = prior.bounds[0] is not None and prior.bounds[0] >= 0
    if entry:
        spread = parts.prior(where, dict(entry))
        if spread.bounds[0] is None or spread.bounds[0] < 0:
            raise UserError(f"{where}: a spread cannot be negative; give a prior such as {{half_normal: {_SPREAD}}}")
    else:
        sd = 0.5 * float(prior.quantile(0.84) - prior.quantile(0.16))
        spread = Prior("half_normal", _SPREAD if is_log else _SPREAD * sd)
    return Varying(name, list(free).index(name), is_log, spread, *possible().get(name, ANYTHING))
