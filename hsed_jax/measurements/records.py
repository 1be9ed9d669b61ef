"""Record files: one time history each, as text, Parquet, MATLAB, HDF5 or PEER `.AT2`."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.at2 import read_at2
from hsed_jax.measurements.budget import ask
from hsed_jax.measurements.containers import CONTAINERS, Variable, opened
from hsed_jax.measurements.heads import ask_of_units
from hsed_jax.measurements.tables import read_record_table

TEXT = ("csv", "txt", "tsv", "dat")
FORMATS = (*TEXT, *CONTAINERS, "at2")
"""Endings of record files that can be read."""

# MATLAB's notation of a column or a row of a matrix.
_PART = re.compile(r"(.+)\((?::\s*,\s*(\d+)|(\d+)\s*,\s*:)\)")


def read_columns(
    path: Path, wanted: Iterable[str], optional: Iterable[str] = (), units: Mapping[str, str] | None = None
) -> dict[str, np.ndarray]:
    """Read columns of a record file, as numbers in the file's units.

    Arguments:
        path: The file; its ending tells the format.  In MATLAB and HDF5 files a column is a variable or dataset, and
            ``group/name`` or ``struct.field`` reaches into groups and structures, ``name(:,2)`` is the second column of a
            matrix and ``name(2,:)`` its second row.
        wanted: Columns to read.
        optional: Those of them that a file may lack if it holds all the others and nothing else.
        units: Declared unit by column; a row of units in a text must agree with it.

    Returns:
        Each column (n,).

    Raises:
        UserError: The file is unreadable or goes beyond the budget, a column is missing, is not a vector of numbers, differs in
            length, or is in another unit than declared.
    """
    wanted, optional = list(wanted), set(optional)
    if _ending(path) in TEXT:
        table = read_record_table(path, wanted)
        ask_of_units(path, table.units, units or {})
        return table.numbers(_present(wanted, optional, table.columns))
    with opened(path) as found:
        parts = {name: _part(path, found, name) for name in _present(wanted, optional, found)}
        ask(path, numbers=sum({part.name: part.variable.size for part in parts.values()}.values()))
        columns = {name: part.read() for name, part in parts.items()}
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise UserError(f"{path}: the columns differ in length ({lengths}); one number per sample in each")
    if 0 in lengths.values():
        raise UserError(f"{path}: the columns are empty; a record has at least one sample")
    return columns


def vectors_of(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str], list[str], dict[str, str]]:
    """Read every vector of a binary file that could be a channel, and report the faults of the others.

    Arguments:
        path: The file; its ending tells the format.  Columns of a matrix have the names that `read_columns` takes.

    Returns:
        Vectors by name, in the file's units, each (n,) with its own n; faults by name; all names in the file's order;
        units by name, if the file has them.

    Raises:
        UserError: The file is unreadable or goes beyond the budget.
    """
    columns: dict[str, np.ndarray] = {}
    faults: dict[str, str] = {}
    units: dict[str, str] = {}
    _ending(path)
    with opened(path) as found:
        numeric = {name: v for name, v in found.items() if v.is_numeric and len(v.shape) <= 2}
        ask(path, numbers=sum(v.size for v in numeric.values()))
        names = [part for name in found for part in (_parts(name, numeric[name]) if name in numeric else [name])]
        ask(path, parts=len(names))
        wholes = {name: variable.read() for name, variable in numeric.items()}
        for name in names:
            try:
                columns[name] = _part(path, found, name).read(wholes)
            except UserError as error:
                faults[name] = str(error).removeprefix(f"{path}: ").removeprefix(f"{path}, ")
            if name in found and found[name].unit:
                units[name] = found[name].unit
    return columns, faults, names, units


def read_motion(path: Path) -> dict[str, np.ndarray]:
    """Read a `.AT2` file as channels `time` [s] and `ground_acceleration` [m/s²], each (n,).

    Raises:
        UserError: As `read_at2`.
    """
    dt, acceleration = read_at2(path)
    return {"time": np.arange(acceleration.size) * dt, "ground_acceleration": acceleration}


def _ending(path: Path) -> str:
    ending = path.suffix.lower().lstrip(".")
    if ending not in (*TEXT, *CONTAINERS):
        raise UserError(
            f"{path}: records ending in {path.suffix!r} cannot be read; allowed: .{', .'.join((*TEXT, *CONTAINERS))}"
        )
    return ending


def _present(wanted: list[str], optional: set[str], found: Iterable[str]) -> list[str]:
    """Leave out the optional columns if the file holds all the others and nothing else.

    An unknown column may be a misspelt one. Then no column is optional, and the message names the missing one.
    """
    others = [name for name in wanted if name not in optional]
    return others if set(found) - {""} == set(others) else wanted


@dataclass(frozen=True)
class _Part:
    """A variable of a binary file, or a column or row of it; `said` is its given name."""

    path: Path
    said: str
    name: str
    variable: Variable
    of_matrix: re.Match | None

    def read(self, wholes: Mapping[str, object] | None = None) -> np.ndarray:
        """The numbers, (n,); variables that were read already are in `wholes`."""
        if not self.variable.is_numeric:
            raise self._fault()
        whole = wholes[self.name] if wholes and self.name in wholes else self.variable.read()
        array = np.asarray(whole)
        if self.of_matrix is not None:
            array = self._of(array, self.of_matrix)
        if array.ndim > 1 and array.size == max(array.shape):
            array = array.reshape(-1)  # MATLAB has rows and columns, no vectors
        array = np.atleast_1d(array)
        if array.ndim != 1 or array.dtype.kind not in "iuf":
            raise self._fault()
        return array.astype(float)

    def _of(self, matrix: np.ndarray, part: re.Match) -> np.ndarray:
        axis, number = (0 if part[2] is None else 1), int(part[2] or part[3])
        if matrix.ndim != 2 or not 1 <= number <= matrix.shape[axis]:
            raise UserError(
                f"{self.path}: there is no {part[0]}; {part[1]!r} has shape {self.variable.shape}, counted from 1"
            )
        return matrix.take(number - 1, axis)

    def _fault(self) -> UserError:
        shape = self.variable.shape
        columns = f"; one column of the matrix is {self.said}(:,1)" if len(shape) == 2 else ""
        return UserError(
            f"{self.path}: column {self.said!r} has shape {shape} and type {self.variable.type}; "
            f"a channel is a vector of real numbers{columns}"
        )


def _part(path: Path, found: Mapping[str, Variable], said: str) -> _Part:
    """The object of a name; a structure of MATLAB is a group in a v7.3 file."""
    matrix = _PART.fullmatch(said)
    for name, part in ((said, None), *([(matrix[1], matrix)] if matrix else [])):
        for spelled in (name, name.replace(".", "/")):
            if spelled in found:
                return _Part(path, said, spelled, found[spelled], part)
    raise UserError(f"{path}: column {said!r} is missing; the file has {', '.join(sorted(found)) or 'none'}")


def _parts(name: str, variable: Variable) -> list[str]:
    """The vectors of a variable, as `read_columns` names them: of a matrix its columns, or its rows where it lies."""
    if len(variable.shape) < 2 or variable.size == max(variable.shape):
        return [name]
    rows, columns = variable.shape
    if rows >= columns:
        return [f"{name}(:,{k})" for k in range(1, columns + 1)]
    return [f"{name}({k},:)" for k in range(1, rows + 1)]
