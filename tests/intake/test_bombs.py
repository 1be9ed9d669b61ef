"""Files that declare or unpack to more than is read are refused before they take memory or time, and damaged ones in one line."""

import io
import resource
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from hsed_jax.errors import UserError
from hsed_jax.intake.opening import opened_file
from hsed_jax.measurements.records import read_columns

# A process may grow by so much while it refuses a file, and take so long on a processor [s].
GROWTH, SECONDS = 300 * 2**20, 20


def workbook(path: Path, rows: str, dimension: str = "A1", strings: str | None = None) -> Path:
    """A workbook with a sheet of this XML."""
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["text"] if strings else [1])
    book.save(path)
    members = {}
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            members[name] = archive.read(name)
    head = b'<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main">'
    about = f'<dimension ref="{dimension}"/><sheetData>{rows}</sheetData></worksheet>'
    members["xl/worksheets/sheet1.xml"] = head + about.encode()
    if strings is not None:
        members["xl/sharedStrings.xml"] = strings.encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def row(number, **cells):
    return f'<row r="{number}">' + "".join(f'<c r="{c}{number}"><v>{v}</v></c>' for c, v in cells.items()) + "</row>"


def corners(path):
    return workbook(path / "a.xlsx", row(1, A=1, B=2) + row(1048576, A=1, XFD=2))


def declared_size(path):
    return workbook(path / "a.xlsx", row(1, A=1, B=2) + row(2, A=3, B=4), "A1:XFD1048576")


def rows_beyond(path):
    return workbook(path / "a.xlsx", row(1, A=1, B=2) + row(10**15, A=1, B=2))


def much_xml(path):
    return workbook(path / "a.xlsx", row(1, A=1, B=2) + " " * 2**27)


def many_strings(path):
    head = '<sst xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main">'
    return workbook(path / "a.xlsx", row(1, A=1, B=2), strings=head + "<si><t>ab</t></si>" * 4_000_000 + "</sst>")


def matlab(path, elements):
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    (path / "a.mat").write_bytes(head + elements)
    return path / "a.mat"


def element(kind, content):
    return np.array([kind, len(content)], "<u4").tobytes() + content


def vector(name, count):
    about = element(6, np.array([6, 0], "<u4").tobytes()) + element(5, np.array([count, 1], "<i4").tobytes())
    return about + element(1, name.ljust(8, b"\0"))


def matlab_of_zeros(path):
    """A compressed vector of 4e8 bytes in some hundred kilobytes."""
    size = 50_000_000
    packing = zlib.compressobj(1)
    head = vector(b"F", size)
    packed = packing.compress(np.array([14, (len(head) + 8 + 8 * size) % 2**32], "<u4").tobytes() + head)
    packed += packing.compress(np.array([9, (8 * size) % 2**32], "<u4").tobytes())
    for _ in range(100):
        packed += packing.compress(bytes(8 * size // 100))
    packed += packing.flush()
    return matlab(path, element(15, packed))


def matlab_of_cells(path):
    """A cell array of ten million empty matrices."""
    inside = element(14, b"") * 8_000_000
    about = element(6, np.array([1, 0], "<u4").tobytes()) + element(5, np.array([8_000_000, 1], "<i4").tobytes())
    whole = element(14, about + element(1, b"F".ljust(8, b"\0")) + inside)
    return matlab(path, element(15, zlib.compress(whole)))


def hdf5_of_columns(path):
    """Each column alone would fit."""
    import h5py

    with h5py.File(path / "a.h5", "w") as file:
        for k in range(50):
            file.create_dataset(f"c{k}", shape=(10_000_000,), dtype=float, chunks=(1024,))
    return path / "a.h5"


def hdf5_of_one_chunk(path):
    import h5py

    with h5py.File(path / "a.h5", "w") as file:
        whole = file.create_dataset("F", (10,), maxshape=(None,), chunks=(400_000_000,), dtype="u1", compression="gzip")
        whole.id.write_direct_chunk((0,), zlib.compress(bytes(400_000_000)))
    return path / "a.h5"


def hdf5_of_nodes(path):
    import h5py

    with h5py.File(path / "a.h5", "w", libver="latest") as file:
        for k in range(20_000):
            file.create_group(f"g{k}")
    return path / "a.h5"


def parquet_of_one_value(path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    piece = pa.table({name: np.zeros(1_000_000) for name in ("t", "u", "F")})
    with pq.ParquetWriter(path / "a.parquet", piece.schema) as file:
        for _ in range(5):
            file.write_table(piece)
    return path / "a.parquet"


def text_of_cells(path):
    (path / "a.csv").write_text("1,2\n" * 12_000_000)
    return path / "a.csv"


def text_of_blanks(path):
    (path / "a.txt").write_text("1 2\n" * 12_000_000)
    return path / "a.txt"


def text_of_bytes(path):
    with (path / "a.csv").open("wb") as file:
        file.truncate(2**31)
    return path / "a.csv"


BOMBS = [corners, declared_size, rows_beyond, much_xml, many_strings, matlab_of_zeros, matlab_of_cells, hdf5_of_columns,
         hdf5_of_one_chunk, hdf5_of_nodes, parquet_of_one_value, text_of_cells, text_of_blanks, text_of_bytes]  # fmt: skip


@pytest.fixture
def limited(tmp_path):
    """A process that may grow by `GROWTH` while it reads."""

    def read(make):
        path = make(tmp_path)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        before = resource.getrlimit(resource.RLIMIT_AS)
        begun = time.process_time()
        resource.setrlimit(resource.RLIMIT_AS, (used + GROWTH, before[1]))
        try:
            return opened_file(path)
        finally:
            resource.setrlimit(resource.RLIMIT_AS, before)
            assert time.process_time() - begun < SECONDS

    return read


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="this system does not tell what a process uses")
@pytest.mark.parametrize("make", BOMBS, ids=lambda make: make.__name__)
def test_a_bomb_is_refused_before_it_takes_memory(limited, make):
    if make is declared_size:  # what a sheet says of its size is not believed
        np.testing.assert_array_equal(limited(make).tables["Sheet"].columns["2"], [2, 4])
        return
    with pytest.raises(UserError) as caught:
        limited(make)
    assert ("rows beyond" if make is rows_beyond else "are more than the allowed") in str(caught.value)


def test_of_a_file_of_many_columns_those_that_are_wanted_are_read(tmp_path):
    path = hdf5_of_columns(tmp_path)
    assert read_columns(path, ["c3"])["c3"].shape == (10_000_000,)
    path = parquet_of_one_value(tmp_path)
    assert read_columns(path, ["F"])["F"].shape == (5_000_000,)
    with pytest.raises(UserError, match="15,000,000 numbers are more than the allowed"):
        read_columns(path, ["t", "u", "F"])


def test_a_file_of_many_small_data_sets_is_read_at_once(tmp_path):
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        for k in range(400):
            file[f"about{k}"] = float(k)
    begun = time.process_time()
    assert len(opened_file(tmp_path / "a.h5").tables[""].columns) == 400
    assert time.process_time() - begun < 5


def test_a_data_set_that_lies_in_another_file_is_not_read(tmp_path):
    import h5py

    (tmp_path / "mine").write_bytes(bytes(80))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("F", shape=(10,), dtype=float, external=[(str(tmp_path / "mine"), 0, 80)])
    with pytest.raises(UserError, match="'F' lies in another file"):
        read_columns(tmp_path / "a.h5", ["F"])


@pytest.mark.parametrize("name", ["pipe.csv", "folder.csv", "pipe.mat", "pipe.xlsx"])
def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path, name):
    import os

    path = tmp_path / name
    path.mkdir() if name.startswith("folder") else os.mkfifo(path)
    with pytest.raises(UserError, match="it is no file"):
        opened_file(path)


# Which of the tags, texts and bytes is damaged is drawn; openpyxl, zlib and expat answer by some ten exceptions of their own.
@pytest.mark.parametrize("seed", range(60))
def test_a_damaged_workbook_is_one_line(tmp_path, seed):
    path = workbook(tmp_path / "a.xlsx", "".join(row(k, A=k, B=k / 3) for k in range(1, 20)))
    draw = np.random.default_rng(seed)
    if seed % 2:
        content = bytearray(path.read_bytes())
        for at in draw.integers(0, len(content), 3):
            content[at] = draw.integers(256)
    else:  # within a member, so that it is unpacked and parsed
        packed = io.BytesIO()
        with zipfile.ZipFile(path) as archive, zipfile.ZipFile(packed, "w") as again:
            hit = archive.namelist()[draw.integers(len(archive.namelist()))]
            for name in archive.namelist():
                member = bytearray(archive.read(name))
                if name == hit:
                    for at in draw.integers(0, len(member), 3):
                        member[at] = draw.integers(256)
                again.writestr(name, bytes(member))
        content = packed.getvalue()
    path.write_bytes(content)
    try:
        assert opened_file(path).tables
    except UserError as error:
        assert str(error).startswith(str(path)) and "\n" not in str(error)
