"""One history from a file that is not a campaign: the excitation of the experiments of a study."""

from pathlib import Path

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.records import TEXT, read_columns, read_motion
from hsed_jax.measurements.tables import read_record_table


def read_history(path: Path, channel: str) -> tuple[np.ndarray, np.ndarray]:
    """Read times and one channel, in SI units.

    Arguments:
        path: A `.AT2` file of a ground motion, or a record with the columns `time` and `channel`; a text file without columns of
            these names has the time in its first and the channel in its second column.
        channel: Such as `force`.

    Returns:
        Times [s] and samples, each (n,).

    Raises:
        UserError: The file cannot be read, lacks a column, has values that are not finite numbers, or a time that does
            not increase.
    """
    ending = path.suffix.lower().lstrip(".")
    if ending == "at2" and channel == "ground_acceleration":
        columns = read_motion(path)
    elif ending in TEXT:
        # Columns with other names are chosen by their positions.
        table = read_record_table(path, ())
        named = [name for name in ("time", channel) if name in table.columns]
        chosen = named if len(named) == 2 else table.columns[:2]
        if len(chosen) < 2:
            raise UserError(f"{path}: it has one column; the time [s] and the {channel.replace('_', ' ')} are wanted")
        columns = dict(zip(("time", channel), table.numbers(chosen).values(), strict=True))
    else:
        columns = read_columns(path, ["time", channel])
    time, values = columns["time"], columns[channel]
    if time.size < 2 or not (np.isfinite(time).all() and np.isfinite(values).all() and np.all(np.diff(time) > 0)):
        raise UserError(f"{path}: at least two finite numbers at increasing times are required")
    return time, values
