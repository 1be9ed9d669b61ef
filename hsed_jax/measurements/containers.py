"""The variables of a binary file (Parquet, MATLAB, HDF5, NumPy, TDMS), listed before they are read.

The libraries that read these formats raise any exception on damaged bytes, and allocate as much as the bytes declare.
"""

import math
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.budget import MOST, ask, ask_of_file

HDF5 = ("h5", "hdf5", "hdf")
CONTAINERS = ("parquet", "mat", *HDF5, "npz", "tdms")
"""Endings of binary files of columns."""

# Types of elements of a MATLAB file, and how much is unpacked at a time.
_MATRIX, _COMPRESSED = 14, 15
_PIECE = 2**20


@dataclass(frozen=True)
class Variable:
    """A column, data set or variable of a file.

    Attributes:
        shape: of it.
        type: of its elements, in words.
        is_numeric: whether they are real numbers.
        read: reads it, while the file is open.
        unit: as in the file; empty if it has none.
    """

    shape: tuple[int, ...]
    type: str
    is_numeric: bool
    read: Callable[[], Any]
    unit: str = ""

    @property
    def size(self) -> int:
        """How many elements it has."""
        return math.prod(self.shape)


@contextmanager
def opened(path: Path) -> Iterator[dict[str, Variable]]:
    """Within this context, the variables of a binary file by name, in its order; they are not read yet.

    Raises:
        UserError: it cannot be read, a variable is damaged (raised within the context), or it exceeds the budget.
    """
    ending = path.suffix.lower().lstrip(".")
    ask_of_file(path, whole=False)
    if ending == "parquet":
        name, listed = "as Parquet", _parquet
    elif ending == "mat" and not _is_hdf5(path):
        name, listed = "as a MATLAB file", _matlab
    elif ending == "npz":
        name, listed = "as NumPy arrays", _numpy
    elif ending == "tdms":
        name, listed = "as TDMS", _tdms
    else:
        name, listed = "as HDF5", _hdf5
    try:
        with listed(path) as found:
            ask(path, parts=len(found))
            yield found
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{path}: cannot be read {name} ({_said(error)})") from None


def _said(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


@contextmanager
def _parquet(path: Path) -> Iterator[dict[str, Variable]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        about = file.metadata
        ask(path, parts=about.num_columns)
        schema = file.schema_arrow

        def column(i: int) -> Variable:
            field = schema.field(i)
            is_numeric = pa.types.is_integer(field.type) or pa.types.is_floating(field.type)
            # By its position, because another column may have the same name, or a nested one such a part.
            read = lambda: file.read(columns=[field.name]).column(0).to_numpy()  # noqa: E731
            return Variable((about.num_rows,), str(field.type), is_numeric, read)

        yield {schema.field(i).name: column(i) for i in range(len(schema))}


def _is_hdf5(path: Path) -> bool:
    import h5py

    return bool(h5py.is_hdf5(path))


@contextmanager
def _hdf5(path: Path) -> Iterator[dict[str, Variable]]:
    import h5py

    found: dict[str, Variable] = {}
    # MATLAB writes a matrix by columns, HDF5 reads it by rows.
    turned = path.suffix.lower() == ".mat"
    parts = 0

    def collect(name: str, node: Any) -> None:
        nonlocal parts
        parts += 1
        ask(path, parts=parts)
        if isinstance(node, h5py.Dataset):
            if node.external or node.is_virtual:
                raise UserError(f"{path}: {name!r} lies in another file; write its numbers into this one")
            # A chunk is always unpacked whole.
            ask(f"{path}: a chunk of {name!r}", numbers=math.prod(node.chunks or ()))
            shape = tuple(node.shape or ())
            read = (lambda: np.transpose(node[()])) if turned else (lambda: node[()])
            found[name] = Variable(
                shape[::-1] if turned else shape,
                str(node.dtype),
                node.shape is not None and node.dtype.kind in "iuf",
                read,
                _unit(node.attrs),
            )

    with h5py.File(path, "r") as file:
        file.visititems(collect)
        yield found


def _unit(attributes: Any) -> str:
    """The unit among the attributes of a variable, under its usual names."""
    for name in ("unit", "units", "Unit", "Units", "unit_string"):
        said = attributes.get(name)
        said = said.decode(errors="replace") if isinstance(said, bytes) else said
        if isinstance(said, str) and said.strip():
            return said.strip()
    return ""


@contextmanager
def _numpy(path: Path) -> Iterator[dict[str, Variable]]:
    with ZipFile(path) as archive:
        members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
        ask(path, parts=len(archive.infolist()), bytes=sum(member.file_size for member in members))
        found: dict[str, Variable] = {}
        for member in members:
            with archive.open(member) as file:
                # A header may declare any shape; the size of the member shows the true content.
                version = np.lib.format.read_magic(file)
                headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
                shape, _, dtype = headers[version](file)
                if math.prod(shape) * dtype.itemsize > member.file_size:
                    raise UserError(f"{path}: {member.filename!r} is cut short")

            def read(member: ZipInfo = member) -> np.ndarray:
                with archive.open(member) as file:
                    return np.lib.format.read_array(file, allow_pickle=False)

            name = member.filename.removesuffix(".npy")
            found[name] = Variable(shape, str(dtype), dtype.kind in "iuf", read)
        yield found


@contextmanager
def _tdms(path: Path) -> Iterator[dict[str, Variable]]:
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise UserError(
            f"{path}: a TDMS file is read by nptdms; install hsed_jax[files], or export it as text"
        ) from None
    with TdmsFile.open(path) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        names = [channel.name for channel in channels]
        found: dict[str, Variable] = {}
        for channel in channels:
            dtype = np.dtype(channel.dtype)
            name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
            read = lambda channel=channel: channel[:]  # noqa: E731
            is_numeric = dtype.kind in "iuf" and len(channel) > 0
            found[name] = Variable((len(channel),), str(dtype), is_numeric, read, _unit(channel.properties))
            step = channel.properties.get("wf_increment")
            if "time" not in found and "time" not in names and isinstance(step, float) and step > 0 and len(channel):
                clock = lambda channel=channel, step=step: np.arange(len(channel)) * step  # noqa: E731
                found["time"] = Variable((len(channel),), "float64", True, clock, "s")
        yield found


@contextmanager
def _matlab(path: Path) -> Iterator[dict[str, Variable]]:
    from scipy.io import loadmat

    ask_of_file(path, whole=True)
    _ask_of_matlab(path)
    content = loadmat(path, simplify_cells=True, appendmat=False)
    found: dict[str, Variable] = {}

    def collect(prefix: str, mapping: dict[str, Any]) -> None:
        for name, value in mapping.items():
            if isinstance(value, dict):
                collect(f"{prefix}{name}.", value)
            elif not name.startswith("__"):
                try:
                    array = np.asarray(value)
                except ValueError:  # a ragged list, which MATLAB calls a cell
                    array = np.empty(0, dtype=object)
                found[prefix + name] = Variable(
                    array.shape, str(array.dtype), array.dtype.kind in "iuf", lambda array=array: array
                )

    collect("", content)
    yield found


def _ask_of_matlab(path: Path) -> None:
    """Refuse a MATLAB file whose unpacked content exceeds the budget: a variable may be compressed a thousandfold.

    The format is that of MATLAB's "MAT-File Format", level 5: elements of a type and a length, one in another.  A file of level 4
    compresses nothing.
    """
    from scipy.io.matlab import matfile_version

    if matfile_version(path, appendmat=False)[0] != 1:
        return
    data = path.read_bytes()
    order = "<" if data[126:128] == b"IM" else ">"
    at, unpacked, parts = 128, 0, 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        content = memoryview(data)[at + 8 : at + 8 + length]
        if kind == _COMPRESSED:
            content = _unpacked(path, content, MOST["bytes"] - unpacked)
        elif kind == _MATRIX:
            content = memoryview(data)[at : at + 8 + length]
        unpacked += len(content)
        parts += _matrices(path, content, order, parts)
        at += 8 + length


def _unpacked(path: Path, content: memoryview, most: int) -> memoryview:
    """Compressed content, unpacked piece by piece up to the budget."""
    unpacking, pieces, size = zlib.decompressobj(), [], 0
    left: Any = content
    while not unpacking.eof and len(left):
        piece = unpacking.decompress(left, _PIECE)
        left = unpacking.unconsumed_tail
        size += len(piece)
        if size > most:
            ask(path, bytes=MOST["bytes"] + size - most)
        pieces.append(piece)
    return memoryview(b"".join(pieces))


def _matrices(path: Path, content: memoryview, order: str, before: int) -> int:
    """Number of matrices in an element, with those within cells and structures."""
    at, count = 0, 0
    while at + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, at)
        if kind == _MATRIX:
            count += 1
            ask(path, parts=before + count)
            at += 8  # its elements come next
        elif kind >> 16:  # a small element has its content in the field of the length
            at += 8
        else:
            at += 8 + length + -length % 8
    return count
