"""The campaign folder: what is written is read back identically, what is broken is refused, nothing in between."""

import csv
import string
import tempfile
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from hsed_jax.errors import UserError
from hsed_jax.measurements import (
    Campaign,
    Channel,
    Experiment,
    Noise,
    Record,
    parse_unit,
    read_campaign,
    units,
    write_campaign,
    write_experiment,
)
from hsed_jax.measurements.tables import can_head_record
from hsed_jax.physics.outputs import is_quantity

quick = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))

# The type checker of the test run draws at random which items of a list it looks at, also inside a strategy.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")

UNITS = {
    "time": ["s", "ms"],
    "ground_acceleration": ["g", "m/s^2", "cm/s²"],
    "elongation": ["m", "mm", "inch", "in"],
    "force": ["N", "kN", "kip"],
    "displacement_1": ["m", "cm"],
    "velocity_2_absolute": ["m/s", "mm/s"],
    "acceleration_1": ["g", "m/s2"],
    "peak_force": ["kN", "N", "kip"],
    "peak_elongation": ["mm", "m"],
    "dissipated_energy": ["J", "kJ", "kN*mm", "kip*inch"],
    "residual_elongation": ["mm", "m"],
    "peak_absolute_acceleration": ["g", "m/s^2"],
    "energy_at_5s": ["J", "kJ"],
}
numbers = st.floats(-1e30, 1e30, allow_nan=False)
texts = st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=12)
columns = st.text(string.ascii_letters + string.digits + " ;,'\"[]()/-_äµ°#%=", min_size=1, max_size=10).filter(
    lambda c: c == c.strip() and can_head_record(c)
)
ids = st.text(string.ascii_letters + string.digits + " _-+,;'ä", min_size=1, max_size=10).filter(
    lambda i: i == i.strip()
)


@st.composite
def records(draw, campaign, motion_only):
    n = draw(st.integers(2, 6))
    arrays = st.lists(numbers | st.just(float("nan")), min_size=n, max_size=n)
    names = [c for c in campaign.channels if c != "time"]
    if motion_only:
        names = ["ground_acceleration"]
    steps = draw(st.lists(st.floats(1e-3, 10), min_size=n, max_size=n))
    time = np.cumsum(steps) if campaign.has_time else np.arange(n)
    return Record(time, {name: np.array(draw(arrays)) for name in names})


@st.composite
def campaigns(draw):
    protocol = draw(st.sampled_from(["ground_motion", "displacement"]))
    needed = ["time", "ground_acceleration"] if protocol == "ground_motion" else ["elongation"]
    others = [c for c in UNITS if not is_quantity(c) and c not in needed]
    channel_names = needed + draw(st.lists(st.sampled_from(others), unique=True, max_size=4))
    quantity_names = draw(st.lists(st.sampled_from([c for c in UNITS if is_quantity(c)]), unique=True, max_size=4))
    input_names = draw(st.lists(st.sampled_from(["V_P", "T_P", "shake, level", "α"]), unique=True))
    reserved = {"id", "record", "status", "reason", "split", "from", "to", *UNITS, *input_names}
    free = columns.filter(lambda c: c not in reserved)
    heads = draw(st.lists(free, unique=True, min_size=10, max_size=10))

    def channel(i, name):
        noise = draw(
            st.none() | st.builds(Noise, absolute=st.floats(0, 1e3)) | st.builds(Noise, relative=st.floats(0, 2))
        )
        return Channel(name, draw(st.sampled_from(UNITS[name])), draw(st.sampled_from(["", heads[i]])), noise)

    campaign = Campaign(
        draw(texts),
        protocol,
        {name: draw(st.sampled_from(["m/s", "s", "g", "%", "-", "kN", "inch"])) for name in input_names},
        {name: channel(i, name) for i, name in enumerate(channel_names)},
        {name: channel(i, name) for i, name in enumerate(quantity_names)},
    )
    metadata_names = heads[len(quantity_names) : len(quantity_names) + 2]
    for id in draw(st.lists(ids, unique=True, max_size=3)):
        status = draw(st.sampled_from(["completed", "completed", "pending", "failed", "abandoned"]))
        quantities = {}
        if status != "pending":
            quantities = {q: draw(numbers) for q in quantity_names if draw(st.booleans())}
        kind = draw(st.sampled_from(["full", "motion", "none"]))
        if status == "completed" and not quantities:
            kind = "full"
        record = None
        if kind == "full" or (kind == "motion" and protocol == "ground_motion"):
            record = draw(records(campaign, motion_only=kind == "motion"))
        window = None
        if record is not None and len(record) > 1 and draw(st.booleans()):
            window = (record.time[0], record.time[draw(st.integers(1, len(record) - 1))])
        campaign = campaign.add(
            Experiment(
                id,
                {name: draw(numbers) for name in input_names},
                record=record,
                quantities=quantities,
                status=status,
                reason=draw(st.none() | texts),
                split=draw(st.sampled_from(["train", "test"])),
                window=window,
                metadata={
                    name: draw(st.text(st.characters(exclude_categories=("Cs", "Cc"))) | st.just("a\nb\r\n# c"))
                    for name in metadata_names
                },
            )
        )
    return campaign


@pytest.mark.whole
@given(campaigns())
@quick
def test_what_is_written_is_read_back_identically(campaign):
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(campaign, folder)
        read = read_campaign(folder)
        assert read == campaign
        assert [list(e.metadata) for e in read] == [list(e.metadata) for e in campaign] or campaign.experiments
        assert not list(Path(folder).rglob("*.tmp"))


@given(campaigns())
@settings(quick, max_examples=15)
def test_xarray_round_trip(campaign):
    assert Campaign.from_xarray(campaign.to_xarray()) == campaign


@given(campaigns())
@settings(quick, max_examples=15)
def test_a_campaign_written_as_it_grows_equals_one_written_at_once(campaign):
    with tempfile.TemporaryDirectory() as folder:
        growing = Campaign(campaign.name, campaign.protocol, campaign.inputs, campaign.channels, campaign.quantities)
        write_campaign(growing, folder)
        assert read_campaign(folder) == growing
        for experiment in campaign:
            growing = growing.add(experiment)
            write_experiment(growing, experiment.id, folder)
            assert read_campaign(folder) == growing


def test_netcdf_round_trip(tmp_path):
    import xarray as xr

    campaign = small()
    campaign.to_xarray().to_netcdf(tmp_path / "c.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "c.nc", engine="h5netcdf") as tree:
        assert Campaign.from_xarray(tree) == campaign


def test_a_tree_of_something_else_is_refused():
    import xarray as xr

    with pytest.raises(UserError, match="to_xarray"):
        Campaign.from_xarray(xr.DataTree(xr.Dataset({"a": 1})))


@pytest.mark.parametrize("unit", ["mm", "inch", "kip", "g", "cm/s", "%", "deg", "kN"])
def test_converting_back_and_forth_keeps_every_bit(unit):
    rng = np.random.default_rng(0)
    values = rng.normal(size=20_000) * 10.0 ** rng.integers(-8, 8, 20_000)
    u = parse_unit(unit)
    si = u.to_si(values)
    np.testing.assert_array_equal(u.to_si(u.from_si(si)), si)
    np.testing.assert_array_equal(u.snap(u.snap(values)), u.snap(values))
    np.testing.assert_allclose(u.snap(values), values, rtol=3e-16)


# What is broken is refused --------------------------------------------------------------------------------------------


def small() -> Campaign:
    """Two experiments with records and a quantity, and a third that is pending."""
    time = np.arange(5) * 0.1
    return Campaign.from_frames(
        [
            {"id": "E01", "V_P": 150.0, "Fmax": 7.5, "note": "first", "from": 0.1, "to": 0.3},
            {"id": "E02", "V_P": 250.0, "Fmax": 8.5, "note": "second", "split": "test"},
            {"id": "E03", "V_P": 300.0, "status": "pending"},
        ],
        {id: {"t": time, "ag": np.sin(time), "F": np.cos(time) + i} for i, id in enumerate(["E01", "E02"])},
        name="frame 3",
        protocol="ground_motion",
        inputs={"V_P": "cm/s"},
        channels={
            "time": Channel("time", "s", "t"),
            "ground_acceleration": Channel("ground_acceleration", "g", "ag"),
            "force": Channel("force", "kN", "F", Noise(relative=0.02)),
        },
        quantities={"peak_force": Channel("peak_force", "kN", "Fmax", Noise(absolute=100.0))},
    )


@pytest.fixture
def folder(tmp_path) -> Path:
    write_campaign(small(), tmp_path)
    return tmp_path


def cells(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def save(path: Path, rows: list[list[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)


def refused(folder: Path, *parts: str) -> str:
    """The one message, which must name file, row and column, and never a private name."""
    with pytest.raises(UserError) as error:
        read_campaign(folder)
    message = str(error.value)
    for part in parts:
        assert part in message, f"{part!r} not in: {message}"
    assert "\n" not in message and "Traceback" not in message and " _" not in message
    return message


BAD_NUMBERS = [
    "abc", "#DIV/0!", "#N/A", "#VALUE!", "####", "1,5", "1,234.5", "1.234,5", "1 234.5", "1'234.5", "2024-01-05",
    "1/2/2024", "5-Jan", "12:30", "5 kN", "5%", "1_000", "0x10", "1e", "--5", "1.2.3", "TRUE", "=A1+B1",
]  # fmt: skip


@given(
    st.sampled_from(BAD_NUMBERS) | st.text(string.ascii_letters + "#!?$", min_size=1, max_size=6),
    st.integers(1, 5),
    st.integers(0, 2),
)
@quick
def test_a_cell_of_a_record_that_is_no_number_is_named(word, row, column):
    if word.lower() in ("nan", "inf", "infinity"):
        return
    with tempfile.TemporaryDirectory() as directory:
        write_campaign(small(), directory)
        path = Path(directory) / "records" / "E02.csv"
        rows = cells(path)
        rows[row][column] = word
        if column == 0 and word.startswith("#") and word not in BAD_NUMBERS:
            return  # a comment line
        save(path, rows)
        refused(Path(directory), "E02.csv", f"row {row + 1}", repr(rows[0][column]))


@given(st.sampled_from([*BAD_NUMBERS, "nan", "inf"]), st.integers(1, 3), st.sampled_from(["V_P", "Fmax", "from", "to"]))
@quick
def test_a_cell_of_experiments_that_is_no_number_is_named(word, row, column):
    with tempfile.TemporaryDirectory() as directory:
        write_campaign(small(), directory)
        path = Path(directory) / "experiments.csv"
        rows = cells(path)
        rows[row][rows[0].index(column)] = word
        save(path, rows)
        refused(Path(directory), "experiments.csv", f"row {row + 1}", column)


@given(campaigns().filter(lambda c: len(c) > 0), st.data())
@settings(quick, max_examples=30)
def test_a_damaged_cell_is_read_back_unchanged_or_refused(campaign, data):
    with tempfile.TemporaryDirectory() as directory:
        write_campaign(campaign, directory)
        path = Path(directory) / "experiments.csv"
        rows = cells(path)
        known = {
            "id",
            *campaign.inputs,
            *(q.column for q in campaign.quantities.values()),
            "from",
            "to",
            "status",
            "split",
        }
        column = data.draw(st.sampled_from(sorted(known & set(rows[0]))))
        row = data.draw(st.integers(1, len(rows) - 1))
        rows[row][rows[0].index(column)] = data.draw(st.sampled_from(["#REF!", "a/b", "1.2/3", "x y z/"]))
        save(path, rows)
        refused(Path(directory), "experiments.csv", f"row {row + 1}", repr(column))


def edit(**changes: str):
    """A change of cells in the table of experiments: column=value in the row of E02."""

    def apply(folder: Path) -> None:
        rows = cells(folder / "experiments.csv")
        for column, value in changes.items():
            rows[2][rows[0].index(column)] = value
        save(folder / "experiments.csv", rows)

    return apply


def replace(file: str, old: str, new: str, count: int = 1):
    def apply(folder: Path) -> None:
        text = (folder / file).read_text(encoding="utf-8")
        assert old in text
        (folder / file).write_text(text.replace(old, new, count), encoding="utf-8")

    return apply


def write(file: str, content: str | bytes):
    def apply(folder: Path) -> None:
        data = content if isinstance(content, bytes) else content.encode()
        (folder / file).write_bytes(data)

    return apply


def remove(file: str):
    return lambda folder: (folder / file).unlink()


BROKEN = {
    "duplicate id": (edit(id="E01"), ["experiments.csv, row 3, column 'id'", "row 2"]),
    "id with a slash": (edit(id="a/b"), ["row 3, column 'id'", "'a/b'"]),
    "id with a backslash": (edit(id="a\\b"), ["row 3, column 'id'"]),
    "id that climbs": (edit(id=".."), ["row 3, column 'id'"]),
    "id like a comment": (edit(id="#2"), ["row 3, column 'id'"]),
    "no id": (edit(id=""), ["row 3, column 'id'"]),
    "wrong status": (
        edit(status="done"),
        ["row 3, column 'status'", "'done'", "completed, pending, failed, abandoned"],
    ),
    "wrong split": (edit(split="both"), ["row 3, column 'split'", "train, test"]),
    "empty input": (edit(V_P=""), ["row 3, column 'V_P'", "empty"]),
    "window after the end": (edit(**{"to": "99"}), ["row 3, column 'to'", "0 to 0.4"]),
    "window before the start": (edit(**{"from": "-1"}), ["row 3, column 'from'"]),
    "window reversed": (edit(**{"from": "0.3", "to": "0.1"}), ["row 3", "'from' must be less than 'to'"]),
    "window between samples": (edit(**{"from": "0.11", "to": "0.12"}), ["row 3", "no sample"]),
    "record elsewhere": (edit(record="records/E09.csv"), ["row 3, column 'record'", "E09.csv"]),
    "record gone": (remove("records/E02.csv"), ["row 3, column 'record'", "E02.csv"]),
    "record of unknown format": (edit(record="campaign.yaml"), ["campaign.yaml", ".csv"]),
    "quantity of a pending one": (edit(status="pending", record=""), ["row 3", "pending", "peak_force", "completed"]),
    "window without record": (edit(status="failed", record="none.csv", to="0.2"), ["row 3, column 'to'", "no record"]),
    "ragged experiments": (
        replace("experiments.csv", "second", "second,more,and"),
        ["experiments.csv, row 3", "cells"],
    ),
    "short experiments": (replace("experiments.csv", ",,second", ""), ["experiments.csv, row 3", "cells"]),
    "no id column": (
        replace("experiments.csv", "id,", "name,"),
        ["experiments.csv, row 1", "'id' is missing", "'name'"],
    ),
    "no input column": (replace("experiments.csv", "V_P", "VP"), ["experiments.csv", "'V_P' is missing", "'VP'"]),
    "merged header": (replace("experiments.csv", "reason", ""), ["experiments.csv, row 1", "empty", "merged"]),
    "repeated header": (replace("experiments.csv", "note", "V_P"), ["experiments.csv, row 1", "'V_P' appears twice"]),
    "unclosed quote": (replace("experiments.csv", "second", '"second'), ["experiments.csv, row 3", "quotes"]),
    "empty experiments": (write("experiments.csv", ""), ["experiments.csv", "empty"]),
    "blank experiments": (write("experiments.csv", "\ufeff\r\n,,,\r\n"), ["experiments.csv"]),
    "workbook": (write("experiments.csv", b"PK\x03\x04rest"), ["experiments.csv", "CSV"]),
    "no experiments": (remove("experiments.csv"), ["experiments.csv", "No such file"]),
    "no declaration": (remove("campaign.yaml"), ["campaign.yaml", "No such file"]),
    "missing column": (replace("records/E02.csv", "F", "G"), ["E02.csv", "'F' is missing", "'G'"]),
    "repeated column": (write("records/E02.csv", "t,ag,F,F\n0,1,2,3\n"), ["E02.csv", "'F'", "2 times"]),
    "merged column": (replace("records/E02.csv", "t,ag,F", "t,,F"), ["E02.csv", "'ag' is missing", "merged"]),
    "ragged record": (replace("records/E02.csv", "0.1,", "0.1,5,5,"), ["E02.csv, row 3", "5 cells", "3"]),
    "empty cell": (replace("records/E02.csv", "0.1,", ","), ["E02.csv, row 3, column 't'", "empty"]),
    "empty record": (write("records/E02.csv", ""), ["E02.csv", "empty"]),
    "record without data": (write("records/E02.csv", "t,ag,F\n\n"), ["E02.csv", "no data"]),
    "comments alone": (write("records/E02.csv", "# a\n# b\n"), ["E02.csv", "no data"]),
    "thousands": (replace("records/E02.csv", "0.1,", '"1,000.5",'), ["E02.csv, row 3, column 't'", "thousands"]),
    "mixed marks": (write("records/E02.csv", "t;ag;F\n0,1;1.5;2\n"), ["E02.csv, row 2, column 'ag'", "throughout"]),
    "error cell first": (
        write("records/E02.csv", "t,ag,F\n0,1,2\n#DIV/0!,1,2\n"),
        ["row 3, column 't'", "spreadsheet"],
    ),
    "empty row inside": (write("records/E02.csv", "t,ag,F\n0,1,2\n,,\n1,1,2\n"), ["row 3, column 't'", "empty"]),
    "unknown key": (replace("campaign.yaml", "unit: g", "units: g"), ["campaign.yaml", "channels.ground_acceleration"]),
    "extra key": (
        replace("campaign.yaml", "unit: g", "unit: g\n    gain: 2"),
        ["ground_acceleration.gain", "column, noise"],
    ),
    "extra top key": (replace("campaign.yaml", "name:", "title: x\nname:"), ["'title'", "protocol"]),
    "key twice": (replace("campaign.yaml", "name:", "name: x\nname:"), ["campaign.yaml", "line 2", "twice"]),
    "protocol": (
        replace("campaign.yaml", "protocol: ground_motion", "protocol: shake"),
        ["protocol", "'shake'", "displacement"],
    ),
    "unknown channel": (replace("campaign.yaml", "  force:", "  forces:"), ["campaign.yaml", "'forces'", "elongation"]),
    "unknown quantity": (replace("campaign.yaml", "peak_force:", "max_force:"), ["'max_force'", "dissipated_energy"]),
    "unknown unit": (
        replace("campaign.yaml", "unit: g", "unit: gee"),
        ["channels.ground_acceleration", "'gee'", "m/s^2"],
    ),
    "wrong dimension": (replace("campaign.yaml", "unit: kN", "unit: mm"), ["channels.force", "'mm'", "force", "kip"]),
    "gram": (replace("campaign.yaml", "unit: kN", "unit: g"), ["channels.force", "'g'"]),
    "unit of an input": (replace("campaign.yaml", "V_P: cm/s", "V_P: cmxs"), ["inputs.V_P", "'cmxs'"]),
    "negative noise": (
        replace("campaign.yaml", "relative: 0.02", "relative: -1"),
        ["channels.force.noise.relative", "-1"],
    ),
    "noise of a kind": (replace("campaign.yaml", "relative: 0.02", "rms: 1"), ["channels.force.noise.rms", "relative"]),
    "no time": (replace("campaign.yaml", "  time:\n    column: t\n    unit: s\n", ""), ["campaign.yaml", "'time'"]),
    "not YAML": (write("campaign.yaml", "name: [a\nprotocol: x"), ["campaign.yaml", "line 2", "YAML"]),
    "a list": (write("campaign.yaml", "- a\n- b\n"), ["campaign.yaml", "keys"]),
    "nothing measured": (
        write("campaign.yaml", "name: a\nprotocol: displacement\n"),
        ["neither channels nor quantities"],
    ),
    "no name": (write("campaign.yaml", "protocol: displacement\n"), ["'name' is missing"]),
    "true for noise": (replace("campaign.yaml", "relative: 0.02", "relative: true"), ["force.noise.relative", "True"]),
    "nested without end": (write("campaign.yaml", "name: " + "[" * 3000), ["campaign.yaml", "more than 50 deep"]),
    "no whole number": (write("campaign.yaml", "name: !!int abc"), ["campaign.yaml", "'abc' is not a whole number"]),
    "unit without end": (replace("campaign.yaml", "unit: kN", "unit: 9**9**9**9"), ["channels.force", "unknown unit"]),
    "id of 300 characters": (edit(id="x" * 300), ["row 3, column 'id'", "is not an id"]),
    "id of 300 bytes": (edit(id="語" * 100), ["row 3, column 'id'", "is not an id"]),
    "id with NUL": (edit(id="a\0b"), ["row 3, column 'id'", "is not an id"]),
    "record with NUL": (edit(record="a\0b"), ["row 3, column 'record'", "is missing"]),
    "record of 300 characters": (edit(record="x" * 300), ["row 3, column 'record'", "is missing"]),
    "input of 1e400": (edit(V_P="1e400"), ["row 3, column 'V_P'", "out of range"]),
    "one row": (write("records/E02.csv", "t,ag,F\n0,1,2\n"), ["E02.csv", "at least two samples"]),
    "infinity": (write("records/E02.csv", "t,ag,F\n0,1,2\n1,1,inf\n"), ["E02.csv", "force is inf at sample 2"]),
    "1e400": (write("records/E02.csv", "t,ag,F\n0,1,2\n1,1e400,1\n"), ["E02.csv", "ground_acceleration is inf"]),
    "endless cell": (write("records/E02.csv", f"t,ag,F\n0,{'1' * 140_000},2\n"), ["E02.csv, row 2", "field limit"]),
    "endless column": (write("records/E02.csv", f"t,ag,F{'x' * 140_000}\n0,1,2\n"), ["E02.csv, row 1", "field limit"]),
    "endless input": (edit(V_P="1" * 140_000), ["experiments.csv, row 3", "field limit"]),
    "two records": (write("records/E02.txt", "1"), []),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_broken_is_refused_with_its_place(folder, case):
    break_it, parts = BROKEN[case]
    break_it(folder)
    if case == "two records":
        edit(record="")(folder)
        parts = ["row 3, column 'id'", "E02.csv, E02.txt"]
    refused(folder, *parts)


def test_no_folder():
    with pytest.raises(UserError, match="no such folder"):
        read_campaign("/nowhere/at/all")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"records": {"E9": {}}}, "E9"),
        ({"experiments": {"name": ["E1"]}}, "'id' is missing"),
        ({"experiments": {"id": ["E1"]}}, "experiment 'E1', column 'x'"),
        ({"experiments": {"id": ["E1"], "x": ["1.5"]}}, "'1.5' is not a number"),
        ({"experiments": {"id": ["E1"], "x": [1.0], "status": ["done"]}}, "'done' is not allowed"),
        ({"experiments": {"id": ["E1", "E1"], "x": [1.0, 2.0]}}, "twice"),
        ({"records": {"E1": {"elongation": [1.0, 2.0]}}}, "lacks \\['force'\\]"),
        ({"records": {"E1": {"elongation": [1.0, 2.0], "force": [1.0]}}}, "same length"),
        ({"records": {"E1": {"elongation": ["a"], "force": [1.0]}}}, "not numeric"),
    ],
)
def test_frames_that_are_broken_are_refused(change, message):
    frames = {"experiments": {"id": ["E1"], "x": [1.0]}, "records": {}} | change
    with pytest.raises(UserError, match=message):
        Campaign.from_frames(
            **frames, protocol="displacement", inputs={"x": "-"}, channels={"elongation": "mm", "force": "kN"}
        )


def test_a_campaign_is_read_in_si_and_shown_as_declared():
    campaign = small()
    assert campaign["E01"].inputs["V_P"] == 1.5
    assert campaign["E01"].quantities["peak_force"] == 7500.0
    np.testing.assert_allclose(campaign["E01"].record["force"], 1000 * np.cos(np.arange(5) * 0.1))
    assert campaign["E01"].in_window.tolist() == [False, True, True, True, False]
    assert [e.id for e in campaign.train] == ["E01"] and [e.id for e in campaign.test] == ["E02"]
    assert len(campaign.completed) == 2 and "E03" in campaign and "E04" not in campaign
    assert "V_P [cm/s]" in repr(campaign) and ">E02</td>" in campaign._repr_html_()
    done = campaign.update(Experiment("E03", {"V_P": 3.0}, quantities={"peak_force": 1.0}))
    assert len(done.completed) == 3 and len(campaign.completed) == 2
    with pytest.raises(UserError, match="E04"):
        campaign["E04"]
    with pytest.raises(UserError, match="twice"):
        campaign.add(campaign["E01"])
    with pytest.raises(ValueError):
        campaign["E01"].record["force"][0] = 1.0


SPELLINGS = ("mm", "kN*mm", "m/s2", "g", "%", "inch/s", "kip", "-", "furlong")


def read_units() -> list:
    units._registry.cache_clear()
    units._in_si.cache_clear()
    return [parse_unit(unit) for unit in SPELLINGS]


def test_units_are_the_same_read_from_the_table_and_from_what_was_kept_of_it(tmp_path, monkeypatch):
    (tmp_path / "no_folder").write_text("")
    monkeypatch.setattr(units, "cache_folder", lambda: tmp_path / "no_folder")
    plain = read_units()
    monkeypatch.setattr(units, "cache_folder", lambda: tmp_path)
    assert read_units() == plain
    kept = list(tmp_path.glob("pint/*.pickle"))
    assert kept
    assert read_units() == plain
    for file in kept:  # as a process leaves it that was killed
        file.write_bytes(file.read_bytes()[:100])
    assert read_units() == plain


@pytest.mark.parametrize("text", units.USUAL)
def test_of_a_usual_unit_pint_would_say_the_same(text):
    assert units.USUAL[text] == units._by_pint(text)
