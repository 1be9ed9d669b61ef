"""At the border of every reader: whatever is fed to it, it reads or it says in one message why not."""

import tempfile
import warnings
from pathlib import Path

import h5py
import hypothesis.strategies as st
import numpy as np
import pandas as pd
import pytest
import yaml
from builders.studies import SMALL, content
from hypothesis import HealthCheck, given, settings
from scipy.io import savemat

from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.measurements import check_campaign, read_at2, read_campaign, write_at2
from hsed_jax.measurements.records import read_columns
from hsed_jax.study.build import Built

# The type checker of the test run draws at random which items of a list it looks at, also inside a strategy.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")

ARRAYS = {"t": np.arange(8) * 0.1, "du": np.sin(np.arange(8.0)), "F": np.cos(np.arange(8.0))}
DECLARATION = """name: test
protocol: displacement
inputs: {V_P: m/s}
channels:
  time: {column: t, unit: s}
  elongation: {column: du, unit: mm, noise: 0.5}
  force: {column: F, unit: kN, noise: {relative: 0.02}}
quantities:
  peak_force: {column: Fmax, unit: kN}
"""
TABLE = "id,record,V_P,Fmax,from,to,split,status,note\nE01,,1.5,3,0.1,0.6,train,completed,a\nE02,,2,,,,test,pending,\n"


def valid_files() -> dict[str, bytes]:
    """One valid file of every kind that is read, by name."""
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        frame = pd.DataFrame(ARRAYS)
        frame.to_parquet(at / "E01.parquet")
        savemat(at / "E01.mat", ARRAYS)
        with h5py.File(at / "E01.h5", "w") as file:
            for name, values in ARRAYS.items():
                file[name] = values
        write_at2(at / "E01.at2", 0.01, ARRAYS["F"])
        text = {"E01.csv": frame.to_csv(index=False), "E01.txt": frame.to_csv(index=False, sep=" ")}
        text |= {"campaign.yaml": DECLARATION, "experiments.csv": TABLE, "study.yaml": SMALL}
        return {
            **{name: said.encode() for name, said in text.items()},
            **{f.name: f.read_bytes() for f in at.iterdir()},
        }


VALID = valid_files()

# --- what breaks readers --------------------------------------------------------------------------------------------

CELLS = [
    "", "nan", "inf", "-inf", "1e400", "-1e400", "1e-320", "1e308", "9" * 400, "9" * 5000, "x" * 140_000, "\0", "a\0b", "../a",
    "a" * 300, "ä" * 150, "true", "!!int abc", "!!float abc", "!!bool abc", "!!timestamp x", "2024-13-45", "!!binary é",
    "!!set {a}", "[", "[" * 3000, "{a: " * 3000, "- " * 3000, "&a [*a]", "*a", "!foo x", "<<: {a: 1}", "=", "~", "'", '"', "#",
    "0x", "1_0", "1:30", "²", "9**9**9**9", "km^99^99", "%", "\ud7ff", "\n", "\r", ",", ";", "\t", "1,5", "NPTS= 9, DT= 0",
]  # fmt: skip


@st.composite
def broken(draw, name: str) -> bytes:
    """A valid file cut, with pieces replaced or repeated, or garbage instead of it."""
    data = bytearray(VALID[name])
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["cut", "bytes", "word", "repeat", "garbage", "cell"]))
        first = draw(st.integers(0, max(len(data) - 1, 0)))
        last = draw(st.integers(first, min(first + 40, len(data))))
        if kind == "cut":
            del data[first:]
        elif kind == "bytes":
            data[first:last] = draw(st.binary(max_size=40))
        elif kind == "word":
            data[first:last] = draw(st.sampled_from(CELLS)).encode()
        elif kind == "repeat":
            data[first:last] = data[first:last] * draw(st.integers(2, 5))
        elif kind == "garbage":
            data = bytearray(draw(st.binary(max_size=200)))
        else:  # one whole cell or value of a text
            words = bytes(data).decode("utf-8", "replace").replace(",", " , ").replace(":", " : ").split(" ")
            words[draw(st.integers(0, len(words) - 1))] = draw(st.sampled_from(CELLS))
            data = bytearray(" ".join(words).encode("utf-8", "replace"))
    return bytes(data)


numbers = st.sampled_from(
    [0.0, -1.0, 1e-320, 1e-200, 1e200, 1e308, float("inf"), float("nan"), 10**400, 2**63, -(2**63)]
)
values = (
    numbers
    | st.booleans()
    | st.none()
    | st.sampled_from(CELLS)
    | st.text(max_size=20)
    | st.integers()
    | st.floats()
    | st.dates()
    | st.binary(max_size=5)
)
trees = st.recursive(
    values,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(CELLS) | st.text(max_size=8), inner, max_size=3),
    max_leaves=5,
)  # fmt: skip


def places(tree, path=()) -> list[tuple]:
    """Every key and position of a tree."""
    found = [path] if path else []
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        found += places(value, (*path, key))
    return found


FULL = content() | {
    "channels": ["force", "elongation"],
    "quantities": ["peak_force"],
    "scales": {"force": 1.0, "elongation": 1.0, "rate": 1.0, "energy": 1.0},
    "steps": ["design", "calibrate", "compare", "diagnose", "improve"],
    "improve": {"add": ["pinching"]},
    "observe": "quantities",
    "correlated_errors": True,
}
FULL["model"] |= {"spring": "bouc_wen", "effects": {"slip": {"delta": {"half_normal": 1.0}}}, "own_effects": []}
FULL["design"] |= {"limits": {"stroke": 1.0}, "stop": {"stable_map": 0.01, "verdict": False}, "kriging": {"starts": 3}}
FULL["excitation"] |= {"step": 0.02}
FULL["experiments"]["virtual"] |= {"noise": {"relative": 0.01}, "test": 1}
SOURCES = [
    {"campaign": "nowhere"}, {"command": {"run": "true {folder}", "timeout": 3.0}}, {"python": "none.py:perform"}, {"folder": {}},
    {"opensees": {"material": "Steel02", "parameters": {"Fy": 1.0}, "step": 0.01}}, {"opensees": {"material": {"file": "a.tcl"}}},
]  # fmt: skip


@st.composite
def studies(draw) -> dict:
    """A valid study with one to three of its keys replaced by something strange."""
    tree = yaml.safe_load(yaml.safe_dump(FULL))
    if draw(st.booleans()):
        tree["experiments"] = draw(st.sampled_from(SOURCES)) | {}
    for _ in range(draw(st.integers(1, 3))):
        *keys, last = draw(st.sampled_from(places(tree)))
        node = tree
        for key in keys:
            node = node[key]
        node[last] = draw(trees)
    return tree


def read_or_refused(read, *arguments) -> None:
    """Nothing else than a `UserError` may come of it, and that says something."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numbers beyond those of a specimen
        try:
            read(*arguments)
        except UserError as error:
            assert 0 < len(str(error).strip()) < 2000, str(error)[:300]


def fed(data) -> None:
    """Feed one reader with something that breaks readers."""
    name = data.draw(st.sampled_from([*VALID, "a study", "an override"]))
    if name == "a study":
        tree = data.draw(studies())
        read_or_refused(lambda: Built(load_study(tree)).check())
        return
    if name == "an override":
        key = data.draw(st.sampled_from([".".join(map(str, p)) for p in places(FULL)]) | st.sampled_from(CELLS))
        read_or_refused(load_study, content(), [f"{key}={data.draw(st.sampled_from(CELLS))}"])
        return
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        (at / "records").mkdir()
        for needed in ("campaign.yaml", "experiments.csv"):
            (at / needed).write_bytes(VALID[needed])
        changed = data.draw(broken(name))
        path = at / (f"records/{name}" if name.startswith("E01") else name)
        path.write_bytes(changed)
        if name == "study.yaml":
            read_or_refused(lambda: load_study(path))
            return
        if not name.startswith("E01"):
            (at / "records/E01.csv").write_bytes(VALID["E01.csv"])
        if path.suffix == ".at2":
            read_or_refused(read_at2, path)
        elif name.startswith("E01"):
            read_or_refused(read_columns, path, list(ARRAYS))
        read_or_refused(lambda: list(check_campaign(read_campaign(at))))


few = settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))


@given(st.data())
@few
def test_every_reader_reads_or_says_why_not(data):
    fed(data)


@pytest.mark.slow
@given(st.data())
@settings(few, max_examples=1000)
def test_every_reader_reads_or_says_why_not_a_thousand_times(data):
    fed(data)
