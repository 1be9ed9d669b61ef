"""Columns of numbers in a file of any format."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Found:
    """The content of a file, before the user chooses channels.

    Attributes:
        columns: columns of numbers by name, in the file's units and order, each (n,); nan where a sample is missing.
        faults: reasons why a column is not one of them, by name.
        names: of all, in the file's order.
        units: of each, as the file writes it; absent where it writes none.
        notes: omissions and decisions of the reading.
        rows: of each sample, the row of the file (n,); without, samples are counted from 1.
        is_named: whether the file names its columns; otherwise their names are positions.
    """

    columns: dict[str, np.ndarray]
    faults: dict[str, str]
    names: list[str]
    units: dict[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    rows: np.ndarray | None = None
    is_named: bool = True

    def place(self, sample: int) -> str:
        """The position of a sample, for a message."""
        return f"sample {sample + 1}" if self.rows is None else f"row {self.rows[sample]}"

    def places(self, is_one: np.ndarray) -> str:
        """The positions of samples (n,) of bool, for a message: the first ones, and their number."""
        where = np.flatnonzero(is_one)
        numbers = where + 1 if self.rows is None else self.rows[where]
        breaks = np.flatnonzero(np.diff(where) > 1)
        starts, ends = np.r_[0, breaks + 1], np.r_[breaks, len(where) - 1]
        said = [
            f"{numbers[a]}" if a == b else f"{numbers[a]} to {numbers[b]}" for a, b in zip(starts, ends, strict=True)
        ]
        kind = "sample" if self.rows is None else "row"
        more = f" and {len(said) - 5} more places" if len(said) > 5 else ""
        return f"{kind}{'s' if len(where) > 1 else ''} {', '.join(said[:5])}{more}"
