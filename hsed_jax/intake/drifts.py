"""The height of a specimen from two columns of its file: a displacement over the drift ratio beside it."""

import re
from collections.abc import Iterator

import numpy as np

from hsed_jax.intake.choice import Choice, unit_of_columns
from hsed_jax.intake.found import Found
from hsed_jax.intake.recognition import unit_of
from hsed_jax.measurements import Finding, parse_unit
from hsed_jax.measurements.spelled import without_unit
from hsed_jax.measurements.units import LENGTH, dimension_of, measures

HEIGHT = (0.05, 500.0)
"""Plausible height of a specimen or structure [m]: a small model, and a tall building."""

_DRIFT = re.compile(r"drift|deriva|層間変形角")
_FOLLOWS = 0.999  # correlation of a displacement with its own drift ratio


def height_doubts(id: str, table: Found, choice: Choice) -> Iterator[Finding]:
    """An implausible height, from a drift ratio beside the elongation.

    Arguments:
        id: of the record.
        table: the columns of its file.
        choice: their meaning.
    """
    column, unit = choice.columns.get("elongation"), choice.units.get("elongation")
    if column is None or unit is None or column not in table.columns or not measures(unit, LENGTH):
        return
    elongation = np.asarray(parse_unit(unit_of_columns(table, column) or unit).to_si(table.columns[column]))
    for name, values in table.columns.items():
        ratio = unit_of(table, name)
        if name == column or ratio is None or not _DRIFT.search(without_unit(name)[0].casefold()):
            continue
        if not (measures(ratio, dimension_of("rad")) or measures(ratio, dimension_of("1"))):
            continue
        drift = np.asarray(parse_unit(ratio).to_si(values))
        known = np.isfinite(drift) & np.isfinite(elongation)
        if known.sum() < 8 or not np.ptp(drift[known]) > 0 or not np.ptp(elongation[known]) > 0:
            continue
        if abs(np.corrcoef(drift[known], elongation[known])[0, 1]) < _FOLLOWS:
            continue  # a drift of another place of the specimen
        height = abs(float(np.polyfit(drift[known], elongation[known], 1)[0]))
        if not HEIGHT[0] <= height <= HEIGHT[1]:
            message = (
                f"over the column {name!r} it says that the specimen is {height:.3g} m high; plausible is {HEIGHT[0]:g} to "
                f"{HEIGHT[1]:g} m: is the unit right?"
            )
            yield Finding("doubt", id, "elongation", None, message, "unit")
