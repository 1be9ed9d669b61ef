"""What damaged files do: `python benchmarks/fuzz.py` mutates record files and run folders, and counts how the package answers.

A file goes through the readers, the functions of the page, and `hsed check`; a run folder through `hsed report`, `hsed export`
and `--resume`.  An answer is right if it is a result or one message: no traceback, no crash of the process, no more than 1 GB, no
minute of waiting, nothing written outside the run folder, and no other column or number in place of what the file says.
"""

import argparse
import contextlib
import csv
import io
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

FORMATS = (
    "comma.csv",
    "semicolon.csv",
    "tab.txt",
    "blanks.dat",
    "v5.mat",
    "v73.mat",
    "a.h5",
    "a.parquet",
    "a.xlsx",
    "a.at2",
)
TABLES = ("campaign.yaml", "experiments.csv", "study.yaml")
MOST_BYTES, MOST_SECONDS = 10**9, 60.0
RIGHT = ("read", "refused")

DECLARED = """name: a specimen
protocol: displacement
channels:
  time: {column: t, unit: s}
  elongation: {column: u, unit: mm}
  force: {column: F, unit: kN}
"""
STUDY = """study: fuzzed
structure:
  masses: [8.0e3, 9.0e3]
  springs: [{between: [ground, 1], stiffness: 4.0e5}, {between: [2, ground], stiffness: 1.0e6}]
  specimen: {between: [1, 2]}
  damping: {modal: 0.05, specimen_stiffness: 5.0e5}
excitation:
  near_fault_pulse: {V_P: V_P, T_P: T_P}
  duration: 5.0
inputs:
  V_P: {uniform: [1.5, 3.0], unit: m/s}
  T_P: {uniform: [0.5, 1.5], unit: s}
model:
  parameters: {A: {uniform: [2.0e5, 9.0e5]}, beta: {uniform: [0.5, 2.0]}, gamma: 0.0, n: 1.0}
experiments:
  virtual: {parameters: {A: 5.0e5, beta: 1.0, gamma: 0.0, n: 1.0}, noise: {relative: 0.01}}
error: {relative: 0.05}
steps: [design, calibrate, compare]
design: {initial: 4, iterations: 1, candidates: 64}
calibration: {sampler: laplace}
"""

Columns = dict[str, list[Any]]


# Files.


def columns() -> Columns:
    """Two cycles of a specimen and a channel beside them."""
    t = np.arange(60) * 0.05
    u = 12 * np.sin(2 * t)
    table = {"t": t, "u": u, "F": 40 * np.tanh(u / 6) + 0.3 * u, "u2": 0.5 * u + 0.1}
    return {name: [round(float(value), 5) for value in values] for name, values in table.items()}


def written(name: str, table: Columns, header: list[str] | None = None) -> bytes:
    """A record file; cells that are no numbers are left to the writer of the format."""
    stem, _, ending = name.partition(".")
    heads = header or list(table)
    values = list(table.values())
    if ending in ("csv", "txt", "dat"):
        separator = {"comma": ",", "semicolon": ";", "tab": "\t", "blanks": " "}[stem]
        mark = "," if stem == "semicolon" else "."
        rows = [heads, *([str(cell).replace(".", mark) for cell in row] for row in zip(*values, strict=False))]
        text = io.StringIO()
        csv.writer(text, delimiter=separator, lineterminator="\n").writerows(rows)
        return text.getvalue().encode()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        _BINARY[name](path, dict(zip(heads, values, strict=True)))
        return path.read_bytes()


def _mat(path: Path, table: Columns) -> None:
    from scipy.io import savemat

    savemat(path, {name: np.asarray(cells)[:, None] for name, cells in table.items()}, do_compression=True)


def _hdf5(path: Path, table: Columns) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512 if path.suffix == ".mat" else 0) as file:
        for name, cells in table.items():
            array = np.asarray(cells)
            file[name] = np.char.encode(array, "utf-8") if array.dtype.kind == "U" else array


def _parquet(path: Path, table: Columns) -> None:
    import pandas as pd

    mixed = {name: any(isinstance(cell, str) for cell in cells) for name, cells in table.items()}
    pd.DataFrame({n: list(map(str, c)) if mixed[n] else c for n, c in table.items()}).to_parquet(path)


def _xlsx(path: Path, table: Columns) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    for row in [list(table), *map(list, zip(*table.values(), strict=False))]:
        book.active.append(row)
    book.save(path)


def _at2(path: Path, table: Columns) -> None:
    from hsed_jax.measurements import write_at2

    write_at2(path, 0.05, np.asarray(table["u"], dtype=float))


_BINARY: dict[str, Callable[[Path, Columns], None]] = {
    "v5.mat": _mat, "v73.mat": _hdf5, "a.h5": _hdf5, "a.parquet": _parquet, "a.xlsx": _xlsx, "a.at2": _at2,
}  # fmt: skip
_WORDS = ("#N/A", "#DIV/0!", "", "off", "12:00:01", "2024-05-01", "1,288", "nan", "-", "1e400", "0x1F", "١٢")


def spoilt(draw: np.random.Generator, name: str) -> tuple[bytes, Columns]:
    """A file with a fault as people make them, and what is in its columns then."""
    table = columns()
    column = str(draw.choice(list(table)))
    row, kind = int(draw.integers(len(table[column]))), int(draw.integers(6))
    footer = kind == 1 and name not in ("a.at2",)
    if kind == 0 or (kind == 1 and not footer):
        table[column][row] = str(draw.choice(_WORDS))
    elif footer:
        for own, cells in table.items():
            cells.append("Max" if own == column else max(cells))
    elif kind == 2:
        table[column] = [str(draw.choice(_WORDS)) for _ in table[column]]
    elif kind == 3:
        del table[column]
        if name == "a.at2":
            table.setdefault("u", [0.0])
    elif kind == 4:
        at = int(draw.integers(len(table)))
        table = dict([*list(table.items())[at:], *list(table.items())[:at]])
    else:
        table = {own: cells[: max(1, row)] for own, cells in table.items()}
    if name in ("v5.mat", "v73.mat", "a.h5", "a.at2"):  # arrays of words are words throughout
        table = {n: list(map(str, c)) if any(isinstance(x, str) for x in c) else c for n, c in table.items()}
    if name == "a.at2":
        table["u"] = [0.0 if isinstance(cell, str) else cell for cell in table["u"]]
    return written(name, table), table


def mutated(draw: np.random.Generator, content: bytes) -> bytes:
    """Content with bytes changed, cut, repeated, or set to what counts and lengths should not be."""
    changed = bytearray(content)
    for _ in range(int(draw.integers(1, 5))):
        at, length = int(draw.integers(len(changed) or 1)), int(draw.integers(1, 64))
        kind = draw.integers(7)
        if kind == 0:
            changed[at : at + 1] = draw.bytes(1)
        elif kind == 1:
            changed[at : at + length] = draw.bytes(length)
        elif kind == 2:
            del changed[at : at + length]
        elif kind == 3:
            changed[at:at] = changed[at : at + length]
        elif kind == 4:
            del changed[at:]
        elif kind == 5:
            at -= at % 4
            changed[at : at + 4] = [b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f"][draw.integers(4)]
        else:
            changed[at : at + 1] = bytes([(changed[at] ^ (1 << int(draw.integers(8)))) if at < len(changed) else 0])
    return bytes(changed)


def within_archive(draw: np.random.Generator, content: bytes) -> bytes:
    """A workbook with one of its members mutated, packed so that it is unpacked and parsed."""
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as again:
        names = archive.namelist()
        hit = names[int(draw.integers(len(names)))]
        for name in names:
            member = archive.read(name)
            again.writestr(name, mutated(draw, member) if name == hit else member)
    return packed.getvalue()


# One case.


@contextlib.contextmanager
def silence() -> Iterator[io.StringIO]:
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        yield said


def answered(work: Callable[[], Any]) -> tuple[str, Any]:
    """How a call ended, and what it returned."""
    from hsed_jax.errors import UserError

    try:
        return "read", work()
    except UserError as error:
        return ("refused" if str(error).strip() and len(str(error)) < 2000 else f"a message of {len(str(error))}"), None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return f"{type(error).__name__}: {error}"[:300], None


def command(*words: str) -> tuple[str, Any]:
    """How a command ended in this process; one line where it refuses."""
    from hsed_jax.command_line import main

    with silence() as said:
        how, status = answered(lambda: main(list(words)))
    if how != "read":
        return how, None
    lines = said.getvalue()
    if status == 2:
        return ("refused" if "error: " in lines and "Traceback" not in lines else f"status 2: {lines[:200]}"), None
    return ("read" if status == 0 else f"status {status}: {lines[:200]}"), None


def paged(folder: Path, name: str, content: bytes, table: Columns | None) -> str:
    """How the page answers to a dropped file; where the file is known, whether it takes what is there."""
    from hsed_jax.app.drops import landed, tables
    from hsed_jax.app.folder import Folder
    from hsed_jax.errors import UserError
    from hsed_jax.intake.choice import campaign_of, chosen, with_units
    from hsed_jax.measurements import check_campaign

    page = Folder(folder)
    how, dropped = answered(lambda: tables(landed(page, {name: content})))
    if how != "read":
        return how
    (found, *_) = dropped.records.values()
    choice = with_units(chosen(found)[0], {"elongation": "mm", "force": "kN", "time": "s"})
    if table is not None:
        for channel, column in (("elongation", "u"), ("force", "F"), ("time", "t")):
            if column in table and choice.columns.get(channel) != column:
                return f"SILENT: {choice.columns.get(channel)} is taken for the {channel}, which is {column}"
        for column, cells in table.items():
            if column not in found.columns and column not in found.faults:
                return f"SILENT: column {column} is neither read nor said"
            if column not in found.columns:
                continue
            read, there = found.columns[column], numbers(cells)
            if len(read) < len(there) and any("left out" in note for note in found.notes):
                there = there[: len(read)]  # a footer, or rows without a number, which are said
            if not np.array_equal(read, there, equal_nan=True):
                return f"SILENT: column {column} is read as other numbers"
    try:
        check_campaign(campaign_of("fuzzed", dropped.records, choice).campaign)
    except UserError:
        return "refused"
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:300]
    return "read"


def numbers(cells: list[Any]) -> np.ndarray:
    """Cells as numbers; what is none is a number that no file has."""

    def number(cell: Any) -> float:
        try:
            return math.nan if str(cell).strip() in ("", "-") else float(str(cell).replace(",", "."))
        except ValueError:
            return -12345.678

    return np.array([number(cell) for cell in cells])


def file_case(number: int, seed: int, folder: Path) -> dict[str, str]:
    """Mutate a file and see how three ways into the package answer."""
    from hsed_jax.intake.opening import opened_file
    from hsed_jax.measurements.records import read_columns, read_motion

    draw = np.random.default_rng([seed, number])
    every = (*FORMATS, *TABLES)
    name = every[number % len(every)]
    campaign = folder / "campaign"
    (campaign / "records").mkdir(parents=True)
    parts = {"campaign.yaml": DECLARED.encode(), "experiments.csv": b"id,record,split\nE01,records/E01.csv,train\n"}
    record, table = written("comma.csv", columns()), None
    if name in TABLES:
        if name != "study.yaml":
            parts[name] = mutated(draw, parts[name])
        place = "E01.csv"
    else:
        place = f"E01.{name.rpartition('.')[2]}"
        if draw.random() < 0.4:
            record, table = spoilt(draw, name)
        else:
            record = written(name, columns())
            record = within_archive(draw, record) if name == "a.xlsx" and draw.random() < 0.7 else mutated(draw, record)
        parts["experiments.csv"] = f"id,record,split\nE01,records/{place},train\n".encode()
    for part, content in parts.items():
        (campaign / part).write_bytes(content)
    path = campaign / "records" / place
    path.write_bytes(record)
    study = STUDY_OF_CAMPAIGN
    (campaign / "study.yaml").write_bytes(mutated(draw, study) if name == "study.yaml" else study)
    found = {"format": name}
    if name not in TABLES:
        if name == "a.at2":
            found["reader"] = answered(lambda: read_motion(path))[0]
        elif name == "a.xlsx":
            found["reader"] = answered(lambda: opened_file(path))[0]
        else:
            both = answered(lambda: read_columns(path, ["t", "u", "F"]))[0], answered(lambda: opened_file(path))[0]
            found["reader"] = next((how for how in both if how not in RIGHT), both[0])
        (folder / "page").mkdir()
        found["page"] = paged(folder / "page", place, record, None if name == "a.at2" else table)
    found["command"] = command("check", str(campaign / "study.yaml"))[0]
    return found


STUDY_OF_CAMPAIGN = b"""study: fuzzed
model: {parameters: {A: {uniform: [1.0e6, 3.0e7]}, beta: {uniform: [20.0, 500.0]}, gamma: 0.0, n: 1.0}}
experiments: {campaign: .}
observe: histories
steps: [calibrate, compare]
"""


# Run folders.

PARTS = ("study.yaml", "summary.json", "results.nc", "provenance.json", "journal.jsonl", "campaign/campaign.yaml",
          "campaign/experiments.csv", "figures", "report.html", "links")  # fmt: skip


def changed_json(draw: np.random.Generator, content: Any) -> Any:
    """JSON with one part gone, or something else in its place."""
    places: list[tuple[Any, Any]] = []
    waiting = [content]
    while waiting:
        node = waiting.pop()
        keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        places += [(node, key) for key in keys]
        waiting += [node[key] for key in keys]
    node, key = places[int(draw.integers(len(places)))]
    instead = [None, 3, "x", [], {}, [1, 2], -1e300][int(draw.integers(7))]
    if draw.random() < 0.5:
        del node[key]
    else:
        node[key] = instead
    return content


def run_case(number: int, seed: int, folder: Path, run: Path) -> dict[str, str]:
    """Mutate a run folder and see how report, export and `--resume` answer."""
    draw = np.random.default_rng([seed, 1, number])
    part = PARTS[number % len(PARTS)]
    mine = folder / "mine"
    mine.mkdir()
    (mine / "file").write_text("mine")
    copy = folder / "run"
    shutil.copytree(run, copy)
    study = folder / "study.yaml"
    study.write_text(STUDY)
    if part == "links":
        files = sorted(copy.rglob("*"))
        place = files[int(draw.integers(len(files)))]
        if draw.random() < 0.4:
            place = copy / f"{draw.choice(('report.html', 'summary.json', 'results.nc'))}.part"
        target = mine / "file" if not place.is_dir() else mine
        if place.is_dir():
            shutil.rmtree(place)
        place.unlink(missing_ok=True)
        place.symlink_to(target)
    else:
        place = copy / part
        if part == "figures":
            pictures = sorted(place.glob("*.svg"))
            place = pictures[int(draw.integers(len(pictures)))]
        if part == "summary.json" and draw.random() < 0.7:
            place.write_text(json.dumps(changed_json(draw, json.loads(place.read_text()))))
        elif part == "journal.jsonl" and draw.random() < 0.6:
            lines = place.read_text().splitlines()
            at = int(draw.integers(len(lines)))
            lines[at] = json.dumps(changed_json(draw, json.loads(lines[at])))
            place.write_text("\n".join(lines) + "\n")
        else:
            place.write_bytes(mutated(draw, place.read_bytes()))
    found = {"format": part}
    found["report"] = command("report", str(copy))[0]
    found["export"] = command("export", str(copy), "--table", "--opensees")[0]
    found["resume"] = answered(lambda: resumed(study, copy))[0]
    if [path.name for path in mine.iterdir()] != ["file"] or (mine / "file").read_text() != "mine":
        found["outside"] = "SILENT: a file outside the run folder is written"
    return found


def resumed(study: Path, run: Path) -> None:
    """What `hsed run --resume` does, without drawing."""
    import hsed_jax as hx

    with silence():
        hx.run(hx.load_study(study), output=run, resume=True, progress=False, figures=False)


# Many.


def measured(work: Callable[[], dict[str, str]]) -> dict[str, Any]:
    """A case with the memory that the process had at most, and its seconds."""
    reset = Path("/proc/self/clear_refs")
    if reset.exists():
        reset.write_text("5")
    begun = time.perf_counter()
    found: dict[str, Any] = work()
    found["seconds"] = time.perf_counter() - begun
    status = Path("/proc/self/status")
    peak = re.search(r"VmHWM:\s+(\d+)", status.read_text()) if status.exists() else None
    found["bytes"] = 1024 * int(peak[1]) if peak else 0
    return found


def wrong(found: dict[str, Any]) -> list[str]:
    """What of a case is not as it should be."""
    ways = ("reader", "page", "command", "report", "export", "resume", "outside")
    faults = [f"{way}: {found[way]}" for way in ways if way in found and found[way] not in RIGHT]
    if found["bytes"] > MOST_BYTES:
        faults.append(f"{found['bytes'] / 1e9:.2f} GB")
    if found["seconds"] > MOST_SECONDS:
        faults.append(f"{found['seconds']:.0f} s")
    return faults


def cases(kind: str, numbers: range, seed: int, run: Path | None = None) -> Iterator[tuple[int, dict[str, Any]]]:
    """Cases in this process, each with its number."""
    for number in numbers:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
            folder = Path(name)
            if kind == "files":
                yield number, measured(lambda number=number, folder=folder: file_case(number, seed, folder))
            else:
                assert run is not None
                yield number, measured(lambda number=number, folder=folder: run_case(number, seed, folder, run))


def finished(folder: Path) -> Path:
    """A run in a folder, as `hsed run` leaves it."""
    (folder / "study.yaml").write_text(STUDY)
    how, _ = command("run", str(folder / "study.yaml"), "--output", str(folder / "run"))
    if how != "read":
        raise SystemExit(f"the run to be mutated did not end well: {how}")
    return folder / "run"


def child(kind: str, first: int, count: int, seed: int, run: Path | None) -> Iterator[tuple[int, dict[str, Any]]]:
    """Cases in a process of their own, begun again behind one that takes the process with it."""
    end = first + count
    while first < end:
        words = [sys.executable, __file__, "--child", kind, str(first), str(end), "--seed", str(seed)]
        with subprocess.Popen(
            [*words, *(["--run", str(run)] if run else [])], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            for line in process.stdout:
                number, found = json.loads(line)
                yield number, found
                first = number + 1
        if first < end:
            yield (
                first,
                {"format": "?", "reader": f"the process ended with {process.returncode}", "bytes": 0, "seconds": 0.0},
            )
            first += 1


def fuzzed(kind: str, count: int, seed: int, workers: int, run: Path | None = None) -> list[str]:
    """Run cases in several processes and print what came of them; returns what is wrong."""
    size = -(-count // workers)
    parts = [(kind, first, min(size, count - first), seed, run) for first in range(0, count, size)]
    with ThreadPoolExecutor(workers) as pool:
        found = sorted(pair for part in pool.map(lambda part: list(child(*part)), parts) for pair in part)
    answers: Counter[str] = Counter()
    faults = []
    for number, case in found:
        for way in ("reader", "page", "command", "report", "export", "resume"):
            if way in case:
                answers[f"{way}: {case[way] if case[way] in RIGHT else 'WRONG'}"] += 1
        faults += [f"case {number}, {case['format']}: {fault}" for fault in wrong(case)]
    print(f"{len(found)} mutated {kind}, seed {seed}")
    for way, times in sorted(answers.items()):
        print(f"  {way:20s} {times:6d}")
    print(
        f"  most memory {max(c['bytes'] for _, c in found) / 1e9:.2f} GB, longest {max(c['seconds'] for _, c in found):.1f} s"
    )
    print(f"  wrong: {len(faults)}")
    for fault in faults:
        print(f"    {fault}")
    return faults


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=2000, metavar="N", help="mutated files (default: 2000)")
    parser.add_argument("--runs", type=int, default=200, metavar="N", help="mutated run folders (default: 200)")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument("--child", nargs=3, metavar=("KIND", "FIRST", "END"), help=argparse.SUPPRESS)
    parser.add_argument("--run", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        kind, first, end = options.child
        for number, found in cases(kind, range(int(first), int(end)), options.seed, options.run):
            print(json.dumps([number, found]), file=sys.__stdout__, flush=True)
        return 0
    faults = fuzzed("files", options.files, options.seed, options.workers) if options.files else []
    if options.runs:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
            run = finished(Path(name))
            faults += fuzzed("runs", options.runs, options.seed, options.workers, run)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
