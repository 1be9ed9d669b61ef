"""Record files: one time history each, as text, Parquet, MATLAB, HDF5 or PEER `.AT2`."""

import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.at2 import read_at2
from hsed_jax.measurements.tables import read_record_table, read_text
from hsed_jax.memory import check_memory

TEXT = ("csv", "txt", "tsv", "dat")
HDF5 = ("h5", "hdf5", "hdf")
FORMATS = (*TEXT, "parquet", "mat", *HDF5, "at2")
"""Endings of record files that can be read."""
# As it is read, as floating-point numbers, in SI, and what a record keeps.
_COPIES = 4

# What MATLAB calls a column of a matrix, or a row of it.
_PART = re.compile(r"(.+)\((?::\s*,\s*(\d+)|(\d+)\s*,\s*:)\)")


def read_columns(path: Path, wanted: Iterable[str], optional: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Read columns of a record file, as numbers in the file's units.

    Args:
        path: The file; its ending tells the format.  In MATLAB and HDF5 files a column is a variable or dataset, and
            ``group/name`` or ``struct.field`` reaches into groups and structures, ``name(:,2)`` is the second column of a
            matrix and ``name(2,:)`` its second row.
        wanted: Columns to read.
        optional: Those of them that a file may lack if it holds all the others and nothing else.

    Returns:
        Each column (n,).

    Raises:
        UserError: The file is unreadable, a column is missing, is not a vector of numbers, or differs in length.
    """
    wanted, optional = list(wanted), set(optional)
    ending = path.suffix.lower().lstrip(".")
    if ending in TEXT:
        table = read_record_table(path, wanted)
        return table.numbers(_present(wanted, optional, table.columns))
    if ending == "parquet":
        found = _parquet(path)
    elif ending == "mat" and not _is_hdf5(path):
        found = _matlab(path)
    elif ending in ("mat", *HDF5):
        found = _hdf5(path, wanted)
    else:
        raise UserError(f"{path}: records ending in {path.suffix!r} cannot be read; allowed: .{', .'.join(FORMATS)}")
    names = _present(wanted, optional, found)
    for name in names:
        part = _PART.fullmatch(name)
        if part is not None and name not in found and part[1] in found:
            found[name] = lambda part=part, whole=found[part[1]]: _part_of(path, part, whole())
    if missing := [name for name in names if name not in found]:
        raise UserError(f"{path}: column {missing[0]!r} is missing; the file has {', '.join(sorted(found)) or 'none'}")
    columns = {name: _vector(path, name, found[name]()) for name in names}
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise UserError(f"{path}: the columns differ in length ({lengths}); one number per sample in each")
    if 0 in lengths.values():
        raise UserError(f"{path}: the columns are empty; a record has at least one sample")
    return columns


def numeric_columns(path: Path) -> dict[str, np.ndarray]:
    """Read every column of a record file that could be a channel: for somebody who is yet to choose.

    Args:
        path: The file; its ending tells the format.  Columns of a matrix have the names that `read_columns` takes.

    Returns:
        Columns of numbers by name, in the file's units and order, each (n,), n being the length that most of them have.

    Raises:
        UserError: The file is unreadable, or has no column of numbers; the message says what is wrong with the first one.
    """
    ending = path.suffix.lower().lstrip(".")
    read: Callable = partial(read_columns, path)
    if ending in TEXT:
        table = read_record_table(path, ())
        names, read = [name for name in table.columns if name], table.numbers
    elif ending == "parquet":
        names = list(_parquet(path))
    elif ending == "mat" and not _is_hdf5(path):
        names = list(_matlab(path))
    elif ending in ("mat", *HDF5):
        names = list(_hdf5(path, []))
    else:
        raise UserError(f"{path}: records ending in {path.suffix!r} cannot be read; allowed: .{', .'.join(FORMATS)}")
    columns, faults = {}, []
    for name in names:
        try:
            columns |= read([name])
        except UserError as error:
            faults.append(error)
            with suppress(UserError):
                for number in count(1):
                    columns |= read([f"{name}(:,{number})"])
    if not columns:
        raise faults[0] if faults else UserError(f"{path}: there is no column of numbers")
    lengths = [len(values) for values in columns.values()]
    usual = max(lengths, key=lengths.count)
    return {name: values for name, values in columns.items() if len(values) == usual}


def read_motion(path: Path) -> dict[str, np.ndarray]:
    """Read a `.AT2` file as channels `time` [s] and `ground_acceleration` [m/s²], each (n,).

    Raises:
        UserError: As `read_at2`.
    """
    dt, acceleration = read_at2(path)
    return {"time": np.arange(acceleration.size) * dt, "ground_acceleration": acceleration}


def _present(wanted: list[str], optional: set[str], found: Iterable[str]) -> list[str]:
    """Leave out the optional columns if the file holds all the others and nothing else.

    A column that nobody asked for may be a misspelt one; then none is optional and the missing one is named.
    """
    others = [name for name in wanted if name not in optional]
    return others if set(found) - {""} == set(others) else wanted


def _parquet(path: Path) -> dict[str, Callable]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            about = file.metadata
            what = f"{path}: {about.num_columns} columns of {about.num_rows} rows"
            check_memory(what, _COPIES * 8 * about.num_rows * about.num_columns)
            table = file.read()
    except (OSError, ValueError, pa.ArrowException) as error:
        raise UserError(f"{path}: cannot be read as Parquet ({error})") from None
    return {name: lambda i=i: table.column(i).to_numpy() for i, name in enumerate(table.column_names)}


def _matlab(path: Path) -> dict[str, Callable]:
    from scipy.io import loadmat

    read_text(path)  # says plainly if the file is missing or empty
    try:
        content = loadmat(path, simplify_cells=True)
    except Exception as error:  # scipy raises whatever the damaged bytes lead to
        raise UserError(f"{path}: cannot be read as a MATLAB file ({error})") from None
    found: dict[str, Callable] = {}

    def collect(prefix, mapping):
        for name, value in mapping.items():
            if isinstance(value, dict):
                collect(f"{prefix}{name}.", value)
            elif not name.startswith("__"):
                found[prefix + name] = lambda v=value: v

    collect("", content)
    return found


def _is_hdf5(path: Path) -> bool:
    import h5py

    return path.is_file() and bool(h5py.is_hdf5(path))


def _hdf5(path: Path, wanted: list[str]) -> dict[str, Callable]:
    import h5py

    found: dict[str, Callable] = {}
    wholes = {*wanted, *(_PART.sub(r"\1", name) for name in wanted)}
    reached = wholes | {name.replace(".", "/") for name in wholes}

    def collect(name, node):
        if isinstance(node, h5py.Dataset):
            values = None
            if name in reached:
                check_memory(f"{path}: {name!r}, declared with shape {node.shape},", _COPIES * node.nbytes)
                values = node[()]
            found[name] = lambda: values

    try:
        with h5py.File(path, "r") as file:
            file.visititems(collect)
    except UserError:
        raise
    except Exception as error:  # h5py raises whatever the damaged bytes lead to
        raise UserError(f"{path}: cannot be read as HDF5 ({error})") from None
    if path.suffix.lower() == ".mat":  # MATLAB writes a matrix by columns, HDF5 reads it by rows
        found = {name: lambda whole=whole: np.transpose(whole()) for name, whole in found.items()}
    for name in (_PART.sub(r"\1", name) for name in wanted):  # a structure of MATLAB is a group in a v7.3 file
        if name not in found and name.replace(".", "/") in found:
            found[name] = found.pop(name.replace(".", "/"))
    return found


def _part_of(path: Path, part: re.Match, values) -> np.ndarray:
    matrix, axis = np.asarray(values), 0 if part[2] is None else 1
    number = int(part[2] or part[3])
    if matrix.ndim != 2 or not 1 <= number <= matrix.shape[axis]:
        raise UserError(f"{path}: there is no {part[0]}; {part[1]!r} has shape {matrix.shape}, counted from 1")
    return matrix.take(number - 1, axis)


def _vector(path: Path, name: str, values) -> np.ndarray:
    try:
        array = np.asarray(values)
    except ValueError:  # a ragged list, which MATLAB calls a cell
        array = np.asarray(values, dtype=object)
    if array.ndim > 1 and array.size == max(array.shape):
        array = array.reshape(-1)  # MATLAB has rows and columns, no vectors
    array = np.atleast_1d(array)
    if array.ndim != 1 or array.dtype.kind not in "iuf":
        columns = f"; one column of the matrix is {name}(:,1)" if array.ndim == 2 else ""
        raise UserError(
            f"{path}: column {name!r} has shape {array.shape} and type {array.dtype}; "
            f"a channel is a vector of real numbers{columns}"
        )
    return array.astype(float)
