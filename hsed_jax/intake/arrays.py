"""Columns of binary files, by the names of their arrays: Parquet, MATLAB, HDF5, NumPy and TDMS."""

from pathlib import Path

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.intake.found import Found
from hsed_jax.measurements.records import vectors_of


def found_in_arrays(path: Path) -> Found:
    """The vectors of a binary file; for a matrix its columns, or its rows if it is wide.

    Raises:
        UserError: the file is unreadable or goes beyond the budget, or has no vector of numbers.
    """
    columns, faults, names, units = vectors_of(path)
    if not columns:
        raise UserError(
            f"{path}, {next(iter(faults.values()))}" if faults else f"{path}: there is no column of numbers"
        )
    notes = []
    singles = [name for name, values in columns.items() if len(values) == 1]
    if len(singles) < len(columns):
        for name in singles:
            faults[name] = f"column {name!r} is a single number"
            del columns[name]
    lengths = [len(values) for values in columns.values()]
    usual = max(lengths, key=lengths.count)
    for name, values in list(columns.items()):
        if len(values) != usual:
            faults[name] = f"column {name!r} has {len(values)} numbers where others have {usual}"
            del columns[name]
    for name, values in list(columns.items()):
        if np.isnan(values).all():
            faults[name] = f"column {name!r} holds no number"
            del columns[name]
    if not columns:
        raise UserError(f"{path}, {next(iter(faults.values()))}")
    return Found(columns, faults, names, units, tuple(notes))
