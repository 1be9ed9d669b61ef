"""The local page: what it refuses, what becomes of dropped files, and in Chromium the story from a raw file to a named effect."""

import asyncio
import gc
import http.client
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from hsed_jax.app import command
from hsed_jax.app.drops import landed, lay_out, read_within, tables
from hsed_jax.app.explore import Explorer
from hsed_jax.app.folder import Folder, checked_name
from hsed_jax.app.jobs import Job
from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.intake.choice import Choice, campaign_of, chosen, with_units
from hsed_jax.intake.found import Found
from hsed_jax.measurements import check_campaign, read_campaign, write_campaign

PEAKS = (0, 8, -8, 8, -8, 16, -16, 16, -16, 28, -28, 28, -28, 40, -40, 40, -40, 0)
# Initial stiffness [kN/mm], 1/mm, loss of stiffness with absorbed energy [1/(kN mm)].
A, BETA, ETA = 12.0, 0.12, 1.5e-4
HEADS = "Displacement [mm],Force [kN]\n"
UNITS = {"elongation": "mm", "force": "kN", "time": "s"}


def specimen(a=A, beta=BETA, eta=ETA, noise=0.0, peaks=PEAKS, samples=24):
    """Elongation [mm] and force [kN] of a Bouc-Wen specimen that degrades, in steps of its own."""
    u = np.concatenate([np.linspace(b, e, samples, endpoint=False) for b, e in pairwise(peaks)])
    force, r, energy = [0.0], 0.0, 0.0
    for du in np.diff(u) / 100:
        for _ in range(100):
            middle = r + 0.5 * (a * du - beta * abs(du) * r) / (1 + eta * energy)
            step = (a * du - beta * abs(du) * middle) / (1 + eta * energy)
            energy += (r + step / 2) * du
            r += step
        force.append(r)
    force = np.asarray(force)
    return u, force + noise * np.sqrt(np.mean(force**2)) * np.random.default_rng(0).standard_normal(len(force))


def text_of(u, force, heads=HEADS):
    return heads + "".join(f"{a:.6f},{b:.6f}\n" for a, b in zip(u, force, strict=True))


RAW = text_of(*specimen(noise=0.01))


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


# The folder.


def test_nothing_outside_the_folder_is_reached(tmp_path):
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir(), outside.mkdir()
    (inside / "link").symlink_to(outside)
    (inside / "loop").symlink_to(inside / "loop")
    (inside / "near").symlink_to(inside / "real")
    folder = Folder(inside)
    for said in ("..", "../outside", "link", "link/file", str(outside), "a/../../outside", "loop/x", "nul\0"):
        with pytest.raises(UserError, match="nothing outside"):
            folder.inside(said)
    assert folder.inside("near") == inside / "real"
    assert folder.inside("a/../b") == inside / "b"


@pytest.mark.parametrize("name", ["../x.csv", "a/b.csv", "a\\b.csv", ".hidden", "", "..", "line\nbreak.csv", "x" * 300])
def test_a_dropped_file_has_a_plain_name(name, folder):
    with pytest.raises(UserError, match="cannot be taken"):
        checked_name(name)
    with pytest.raises(UserError, match="cannot be taken"):
        landed(folder, {name: b"1,2\n"})
    assert list(folder.root.iterdir()) == []


def test_a_file_is_not_dropped_through_a_link(folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    (folder.root / "raw").symlink_to(outside)
    with pytest.raises(UserError, match="nothing outside"):
        landed(folder, {"raw.csv": b"1,2\n"})
    where = landed(folder, {"other.csv": b"1,2\n"})
    (where / "dropped" / "more.csv").symlink_to(outside / "more.csv")
    with pytest.raises(UserError, match="nothing outside"):
        landed(folder, {"more.csv": b"1,2\n"}, where)
    assert list(outside.iterdir()) == []


def test_a_second_drop_of_the_same_name_leaves_the_first_alone(folder):
    first, second = landed(folder, {"raw.csv": b"1,2\n"}), landed(folder, {"raw.csv": b"3,4\n"})
    assert (folder.name(first), folder.name(second)) == ("raw", "raw-2")
    assert (first / "dropped" / "raw.csv").read_bytes() == b"1,2\n"


# What is dropped.


@pytest.mark.parametrize(
    ("name", "content", "columns"),
    [
        ("a.csv", "u [mm],F [kN]\n0,0\n1,2.5\n", ["u [mm]", "F [kN]"]),
        ("a.txt", "0 0\n1 2.5\n", ["1", "2"]),
        ("a.csv", "u;F\n0,0;0,0\n1,0;2,5\n", ["u", "F"]),
        ("a.csv", "time,note,u,F\n0,start,0,0\n1,end,1,2.5\n", ["time", "u", "F"]),
    ],
    ids=["comma", "blanks", "decimal comma", "words left out"],
)
def test_columns_of_numbers_are_found_in_text(folder, name, content, columns):
    (found,) = tables(landed(folder, {name: content.encode()})).records.values()
    assert list(found.columns) == columns
    assert_allclose(list(found.columns.values())[-1], [0, 2.5])


def workbook(path, sheets):
    with pd.ExcelWriter(path) as writer:
        for name, rows in sheets.items():
            pd.DataFrame(rows).to_excel(writer, sheet_name=name, header=False, index=False)
    return path.read_bytes()


def test_sheets_of_a_workbook_are_records(folder, tmp_path_factory):
    rows = [["Test of a column", None, None], [None, None, None], ["Time", "Disp", "Load"], ["s", "mm", "kN"]]
    rows += [[0, 0, 0], [1, 2.5, 10], [2, 5, 15]]
    content = workbook(
        tmp_path_factory.mktemp("made") / "b.xlsx",
        {"north": rows, "south": [["u", "F"], [0, 0], [1, 2]], "notes": [["nothing", "here"]]},
    )
    found = tables(landed(folder, {"frame.xlsx": content})).records
    assert {id: list(one.columns) for id, one in found.items()} == {
        "frame_north": ["Time [s]", "Disp [mm]", "Load [kN]"],
        "frame_south": ["u", "F"],
    }
    assert_allclose(found["frame_north"].columns["Load [kN]"], [0, 10, 15])
    choice, _ = chosen(found["frame_north"])
    assert choice.columns == {"elongation": "Disp [mm]", "force": "Load [kN]", "time": "Time [s]"}
    assert choice.units == {"elongation": "mm", "force": "kN", "time": "s"}


def test_a_matrix_of_matlab_is_columns(folder, tmp_path_factory):
    from scipy.io import savemat

    path = tmp_path_factory.mktemp("made") / "m.mat"
    savemat(path, {"data": np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 3.0]]), "who": "me"})
    (found,) = tables(landed(folder, {"m.mat": path.read_bytes()})).records.values()
    assert list(found.columns) == ["data(:,1)", "data(:,2)"] and list(found.faults) == ["who"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"", "a.csv: the file is empty"),
        ("a.csv", b"the,words\nof,somebody\n", "a.csv: no row has numbers; it begins with 'the,words'"),
        ("a.docx", b"PK\x03\x04", "a.docx: files ending in '.docx' cannot be read"),
        ("a.xlsx", b"no workbook", "a.xlsx: this is not a workbook"),
        ("a.mat", b"MATLAB 5.0 cut short", "a.mat: cannot be read as a MATLAB file"),
        ("a.h5", b"no hdf", "a.h5: cannot be read as HDF5"),
    ],
)
def test_a_bad_file_is_one_message_that_names_it(folder, name, content, message):
    with pytest.raises(UserError) as caught:
        tables(landed(folder, {name: content}))
    assert str(caught.value).startswith(message)
    assert str(folder.root) not in str(caught.value)


def test_a_word_among_numbers_of_a_sheet_is_named(folder, tmp_path_factory):
    rows = [["u", "F"], [0, 0], [1, "broken"], [2, 3]]
    content = workbook(tmp_path_factory.mktemp("made") / "b.xlsx", {"one": rows})
    found = tables(landed(folder, {"b.xlsx": content}))
    said = "sheet 'one', row 3, column 2 holds 'broken'; a number is wanted in every row"
    assert found.records["b"].faults == {"F": said}
    assert found.left_out == [f"record 'b': column 'F' is left out: {said}"]


def test_a_hidden_sheet_is_no_record_and_said(folder, tmp_path_factory):
    import openpyxl

    path = tmp_path_factory.mktemp("made") / "b.xlsx"
    rows = [["u", "F"], [0, 0], [1, 2]]
    workbook(path, {"north": rows, "south": rows, "raw": rows})
    book = openpyxl.load_workbook(path)
    book["raw"].sheet_state = "hidden"
    book.save(path)
    found = tables(landed(folder, {"b.xlsx": path.read_bytes()}))
    assert list(found.records) == ["b_north", "b_south"]
    assert found.left_out == ["b.xlsx: sheet 'raw' is hidden and is left out"]


def test_a_file_that_cannot_be_read_is_said_and_costs_no_other(folder):
    found = tables(landed(folder, {"a.csv": b"u,F\n0,0\n1,2\n", "a.txt": b"u F\n0 0\n1 3\n", "b.mat": b"broken"}))
    assert list(found.records) == ["a", "a-2"]  # of one stem, and two records all the same
    assert len(found.left_out) == 1 and found.left_out[0].startswith("b.mat: cannot be read as a MATLAB file")
    assert found.left_out[0].endswith("the file is left out")


# What took another column in place of the force or of the time.
SPOILT = {
    "an error of a spreadsheet": (
        "t,u,F,u2\n0,0,0,5\n1,1,#N/A,6\n2,2,4,7\n",
        "F",
        "row 3, column 'F': '#N/A' is an error",
    ),
    "a word": ("t,u,F,u2\n0,0,0,5\n1,1,off,6\n2,2,4,7\n", "F", "row 3, column 'F': 'off' is not a number"),
    "a last cell of text": ('t,u,F\n1,2,"x"\n', "F", "row 2, column 'F': 'x' is not a number"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_no_other_column_is_taken_for_one_that_cannot_be_read(folder, case):
    text, name, said = SPOILT[case]
    found = tables(landed(folder, {"a.csv": text.encode()}))
    (spoilt,) = found.records.values()
    choice = with_units(chosen(spoilt)[0], UNITS)
    assert {"elongation": "u", "force": "F", "time": "t"}.items() <= choice.columns.items()
    assert said in spoilt.faults[name]
    assert any(f"column {name!r} is left out" in line and said in line for line in found.left_out)
    with pytest.raises(UserError, match=re.escape(said)):
        campaign_of("a", found.records, choice)


@pytest.mark.parametrize(
    ("text", "time", "said"),
    [
        ("t,u,F\n12:00:01,0,0\n12:00:02,1,1\n", [0, 1], "column 't' holds times of day"),
        ("t,u,F,t\n0,0,0,0\n1,1,1,1\n", [0, 1], None),
        ("t,u,F\n0,0,0\n1,1,1\nMax,1,1\n", [0, 1], "row 4 below the table is left out: 'Max 1 1'"),
    ],
    ids=["clock times", "a second time of the same numbers", "a footer"],
)
def test_what_is_decided_is_said(folder, text, time, said):
    found = tables(landed(folder, {"a.csv": text.encode()}))
    (read,) = found.records.values()
    choice, told = chosen(read)
    assert_allclose(read.columns[choice.columns["time"]], time)
    notes = [*found.left_out, *told.notes]
    assert any((said or "holds the same numbers as 't'") in line for line in notes), notes


def test_of_two_times_that_differ_neither_is_taken(folder):
    found = tables(landed(folder, {"a.csv": b"t,u,F,t\n0,0,0,0\n1,1,1,2\n"}))
    choice, told = chosen(found.records["a"])
    assert "time" not in choice.columns and told.candidates["time"] == ["t", "t (4)"]


def campaign_files(records):
    """The files of a campaign as a browser gives them: names without folders."""
    declared = "channels:\n  elongation: {column: u, unit: mm}\n  force: {column: F, unit: kN}\n"
    listed = "".join(f"{id},{place}\n" for id, place in records.items())
    return {
        "campaign.yaml": f"name: a column\nprotocol: displacement\n{declared}".encode(),
        "experiments.csv": f"id,record\n{listed}".encode(),
        **{Path(place or f"{id}.csv").name: b"u,F\n0,0\n1,2\n2,3\n" for id, place in records.items()},
    }


def test_the_files_of_a_campaign_are_laid_out_as_its_table_says(folder):
    where = landed(folder, campaign_files({"E01": "", "E02": "raw/second.csv"}))
    campaign = lay_out(folder, where)
    assert [e.id for e in campaign] == ["E01", "E02"]
    assert_allclose(campaign["E02"].record["force"], [0, 2000, 3000])


def test_a_campaign_that_names_a_place_outside_is_refused(folder):
    where = landed(folder, campaign_files({"E01": "../../stolen.csv"}))
    with pytest.raises(UserError, match="outside"):
        lay_out(folder, where)
    assert not (folder.root.parent / "stolen.csv").exists()


def test_a_campaign_whose_records_lie_elsewhere_is_not_read(folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "stolen.csv"
    outside.write_text("u,F\n0,0\n1,2\n2,3\n")
    where = landed(folder, campaign_files({"E01": "", "E02": ""}))
    lay_out(folder, where)
    assert [e.id for e in read_within(folder, "campaign")[1]] == ["E01", "E02"]
    (where / "records" / "E02.csv").unlink()
    (where / "records" / "E02.csv").symlink_to(outside)
    with pytest.raises(UserError, match="nothing outside"):
        read_within(folder, "campaign")
    (where / "records" / "E02.csv").unlink()
    (where / "experiments.csv").write_text(f"id,record\nE01,\nE02,{outside}\n")
    with pytest.raises(UserError, match="nothing outside"):
        read_within(folder, "campaign")


# What the columns are.


def table(**columns):
    """Columns of numbers, and nothing that is wrong."""
    return Found(columns, {}, list(columns))


def campaign(**changes):
    u, force = specimen()
    columns = table(u=u, F=force)
    units = {"time": "s", "elongation": "mm", "force": "kN"}
    settings = {"protocol": "displacement", "columns": {"elongation": "u", "force": "F"}, "units": units, **changes}
    return campaign_of("column", {"A": columns, "B": columns}, Choice(**settings)).campaign


def test_a_choice_is_a_campaign_in_si():
    made, (u, force) = campaign(), specimen()
    assert_allclose(made["A"].record["elongation"], 1e-3 * u, rtol=1e-12)
    assert_allclose(made["B"].record["force"], 1e3 * force, rtol=1e-12)
    # Both are of one specimen, sample by sample.
    assert [finding.kind for finding in check_campaign(made)] == ["copy"]


def test_a_turned_sign_is_seen_by_the_checks_of_every_command():
    assert {finding.kind for finding in check_campaign(campaign(turned=frozenset({"force"})))} == {"sign", "copy"}
    both = check_campaign(campaign(turned=frozenset({"force", "elongation"})))
    assert {finding.kind for finding in both} == {"copy"}


def test_what_is_held_out_is_read_back_as_held_out(tmp_path):
    write_campaign(campaign(tests=frozenset({"B"}), held_out=1 / 3), tmp_path)
    again = read_campaign(tmp_path)
    assert [(e.id, e.split) for e in again] == [("A", "train"), ("A_end", "test"), ("B", "test")]
    rows = len(again["A"].record)
    assert again["A"].window == (0, round(2 / 3 * rows) - 1)
    assert again["A_end"].window == (again["A"].window[1] + 1, rows - 1)
    assert {path.name for path in (tmp_path / "records").iterdir()} == {"A.csv", "B.csv"}  # a record is written once


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"columns": {"force": "F"}}, "choose the column of the elongation"),
        ({"columns": {"elongation": "u", "force": "u"}}, "'u' is chosen twice"),
        ({"columns": {"elongation": "u", "force": "G"}}, "record 'A' has no column 'G'"),
        ({"units": {"elongation": "mm", "force": "MPa"}}, "do not belong together"),
        ({"tests": frozenset("AB")}, "leave one to fit"),
    ],
)
def test_a_choice_that_cannot_be_is_one_message(changes, message):
    with pytest.raises(UserError, match=message):
        campaign(**changes)


# The model while sliders move.


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a page with a run in it that found the plain law's own parameters."""
    root = tmp_path_factory.mktemp("finished")
    run = root / "runs" / "column"
    u, force = specimen(eta=0.0, samples=100)
    raw = {"u": u, "F": force}
    columns, units = {"elongation": "u", "force": "F"}, {"elongation": "mm", "force": "kN"}
    write_campaign(
        campaign_of("column", {"column": Found(raw, {}, list(raw))}, Choice("displacement", columns, units)).campaign,
        run / "campaign",
    )
    assert main(["init", str(run / "campaign"), "--output", str(run / "study.yaml")]) == 0
    (run / "provenance.json").write_text("{}")
    (run / "report.html").write_text("<!doctype html><title>made</title><p>a report</p>")
    found = {"A": 1e6 * A, "beta": 1e3 * BETA, "yield_sharpness.delta": 0.0, "error.force": 0.01}
    (run / "summary.json").write_text(
        json.dumps({"study": "column", "status": "complete", "calibration": {"map": found}})
    )
    return root


@pytest.mark.whole
def test_a_slider_moves_the_loop_as_independent_steps_do_and_compiles_nothing(finished):
    explorer = Explorer(finished / "runs" / "column")
    experiment, values = explorer.experiments["column"], explorer.starts["the model as it was"].parameters
    plain = explorer.variant(())
    loop = plain.simulate(values, experiment)
    u, force = specimen(eta=0.0, samples=100)
    assert_allclose(loop.elongation, 1e-3 * u, atol=1e-12)
    assert_allclose(loop.force, 1e3 * force, atol=2e-3 * np.abs(1e3 * force).max())
    assert loop.error < 2e-3

    degrading = explorer.variant(("stiffness_degradation",))
    assert [dial.name for dial in degrading.dials] == ["A", "beta", "stiffness_degradation.delta"]
    # δ = η E_c; a kN mm is a J.
    delta = ETA * degrading.built.simulation.scales.energy
    loop, first = timed(degrading, {**values, "stiffness_degradation.delta": delta}, experiment)
    _, force = specimen(samples=100)
    assert_allclose(loop.force, 1e3 * force, atol=4e-3 * np.abs(1e3 * force).max())

    neutral = degrading.simulate({**values, "stiffness_degradation.delta": 0.0}, experiment)
    assert_allclose(neutral.force, plain.simulate(values, experiment).force, rtol=1e-9, atol=1e-6)
    moved = [
        {**values, "A": factor * values["A"], "stiffness_degradation.delta": 1.0} for factor in np.linspace(0.9, 1.1, 9)
    ]
    assert np.median([timed(degrading, one, experiment)[1] for one in moved]) < first / 10


def timed(variant, values, experiment):
    begun = time.perf_counter()
    return variant.simulate(values, experiment), time.perf_counter() - begun


@pytest.mark.whole
def test_a_run_that_names_code_is_not_explored(finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished / "runs" / "column", run)
    (run / "mine.py").write_text("raise SystemExit('executed')")
    study = (
        (run / "study.yaml").read_text().replace("  spring: bouc_wen", "  spring: bouc_wen\n  own_effects: [mine.py]")
    )
    (run / "study.yaml").write_text(study)
    with pytest.raises(UserError, match="code of your own"):
        Explorer(run)


# Commands in processes of their own.


@pytest.mark.whole
def test_a_command_is_followed_to_its_end(tmp_path):
    done, wrong = Job(["effects", "gap"], tmp_path), Job(["run", "missing.yaml"], tmp_path)
    assert (done.wait(60), wrong.wait(60)) == (0, 2)
    assert done.said[0].startswith("gap (")
    assert wrong.complaint.startswith("error: missing.yaml")
    assert wrong.status == 2
    done._take("calibrate: chains:  45%|████▌     | 9/20 [00:03<00:04]")
    assert (done.share, done.doing) == (45, "calibrate: chains:  9/20 [00:03<00:04]")
    done._take("diagnose: round 2 [00:10]")
    assert (done.share, done.doing) == (None, "diagnose: round 2 [00:10]")
    assert done.complaint == ""


def test_without_the_extra_one_message_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setattr(command, "find_spec", lambda name: None if name == "panel" else object())
    assert main(["app"]) == 2
    assert "hsed app needs panel" in (said := capsys.readouterr().err)
    assert "pip install 'hsed_jax[app]'" in said


# The server.


@pytest.fixture(scope="module")
def served():
    """A factory: the page of a folder in a process of its own."""
    pytest.importorskip("panel")
    pytest.importorskip("openpyxl")
    started = []

    def serve(root):
        said = (root / "said.txt").open("w+")
        code = "from hsed_jax.command_line import main; raise SystemExit(main())"
        process = subprocess.Popen(
            [sys.executable, "-c", code, "app", "--no-browser"],
            cwd=root,
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
        )
        started.append((process, said))
        process.stdout.readline()
        address = process.stdout.readline().strip()
        port, token = address.removeprefix("http://127.0.0.1:").strip("/").split("/")
        return SimpleNamespace(address=address, port=int(port), token=token, root=root)

    yield serve
    for process, said in started:
        process.send_signal(signal.SIGTERM)
        try:
            assert process.wait(30) == 0
            said.seek(0)
            assert "Traceback" not in said.read()
        finally:
            process.kill()
            process.stdout.close()
            said.close()


@pytest.fixture(scope="module")
def server(served, finished, tmp_path_factory):
    """The page of a folder with a run in it, a secret beside it, and links from it to that."""
    root, secret = tmp_path_factory.mktemp("page") / "root", tmp_path_factory.mktemp("secret")
    shutil.copytree(finished, root)
    shutil.copytree(finished / "runs" / "column", secret, dirs_exist_ok=True)
    (root / "runs" / "link").symlink_to(secret)
    (root / "runs" / "column" / "improved.yaml").symlink_to(secret / "study.yaml")
    found = served(root)
    found.secret = secret
    return found


def asked(server, path, **headers):
    """Status, headers and text of an answer; the path goes as it is."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read().decode(errors="replace")
    finally:
        connection.close()


def test_only_who_has_the_token_is_answered_and_nothing_outside_is_handed_out(server):
    root, secret = server.root, server.secret
    own = f"/{server.token}"
    assert len(server.token) >= 32
    # One letter off.
    wrong = server.token[:-1] + ("y" if server.token.endswith("x") else "x")
    socket = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "eA==",
    }
    for path in ("/", "/ws", "/static/js/bokeh.min.js", "/files/runs/column/report.html", "/metadata", "/favicon.ico"):
        assert asked(server, path)[0] == 404
        assert asked(server, f"/{wrong}{path}")[0] == 404
    assert asked(server, f"{own}/")[0] == 200
    assert asked(server, f"{own}/ws", Origin="http://evil.example", **socket)[0] == 403

    status, headers, text = asked(server, f"{own}/files/runs/column/report.html")
    assert (status, text) == (200, (root / "runs" / "column" / "report.html").read_text())
    assert headers["Content-Security-Policy"].startswith("sandbox")
    assert headers["Referrer-Policy"] == "no-referrer"
    assert asked(server, f"{own}/files/runs/column/study.yaml?download")[1]["Content-Disposition"] == "attachment"
    for path in (
        "runs/link/report.html",
        "runs/column/improved.yaml",
        f"../../{secret.name}/report.html",
        f"%2e%2e/%2e%2e/{secret.name}/report.html",
        f"runs/column/..%2f..%2f..%2f..%2f{secret.name}%2freport.html",
        f"{secret}/report.html",
        f"%2f{str(secret)[1:]}/report.html",
        "runs/column/provenance.json",
        "runs/column/campaign/campaign.yaml",
        "runs/column%00/report.html",
    ):
        assert asked(server, f"{own}/files/{path}")[0] == 404, path


def test_it_listens_to_this_machine_alone(server):
    listening = Path("/proc/net/tcp").read_text() if Path("/proc/net/tcp").exists() else ""
    if not listening:
        pytest.skip("there is no /proc/net/tcp")
    local = [line.split()[1] for line in listening.splitlines()[1:] if line.split()[3] == "0A"]
    assert [address for address in local if address.endswith(f":{server.port:04X}")] == [f"0100007F:{server.port:04X}"]


# In Chromium.


@pytest.fixture
def opened(browser):
    """A factory: the page in a tab of its own."""
    pages = []

    def open(server):
        page = browser.new_page(viewport={"width": 1180, "height": 900})
        page.set_default_timeout(60_000)
        pages.append(page)
        page.complaints, page.elsewhere = [], []
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.on("console", lambda said: page.complaints.append(said.text) if said.type == "error" else None)
        own = (f"http://127.0.0.1:{server.port}/{server.token}/", f"ws://127.0.0.1:{server.port}/{server.token}/")
        page.on(
            "request", lambda r: None if r.url.startswith((*own, "data:", "blob:")) else page.elsewhere.append(r.url)
        )
        page.goto(server.address)
        page.get_by_text("What was measured?").wait_for()
        return page

    yield open
    for page in pages:
        assert page.complaints == []
        assert page.elsewhere == []
        page.close()


def drop(page, *files):
    """Give files to the page as a browser does: by name and content."""
    page.locator("input[type=file]").first.set_input_files(
        [{"name": name, "mimeType": kind, "buffer": content.encode()} for name, kind, content in files]
    )


def part(page, name):
    page.get_by_role("tab", name=name).or_(page.locator(".bk-tab", has_text=name)).first.click()


@pytest.mark.whole
def test_files_are_looked_at_while_choosing_and_tabs_know_nothing_of_each_other(server, opened):
    from playwright.sync_api import expect

    root = server.root
    page, other = opened(server), opened(server)
    drop(page, ("notes.txt", "text/plain", "the words\nof somebody\n"))
    page.get_by_role("alert").get_by_text("notes.txt: no row has numbers").wait_for()
    assert not (root / "notes").exists()

    drop(page, ("raw.csv", "text/csv", RAW))
    page.get_by_role("status").get_by_text("notes.txt: no row has numbers").wait_for()
    page.get_by_text("The checks of the data found no doubts").wait_for()
    page.get_by_text("the weight of").wait_for()
    assert (root / "raw" / "dropped" / "raw.csv").read_text() == RAW
    go = page.get_by_role("button", name="Continue with these measurements")
    expect(go).to_be_enabled(timeout=60_000)

    page.get_by_label("turn the sign of the force").check()
    page.get_by_role("alert").get_by_text("a specimen cannot give energy").wait_for()
    expect(go).to_be_disabled(timeout=60_000)
    page.get_by_label("turn the sign of the force").uncheck()
    page.get_by_text("found no doubts").wait_for()

    page.get_by_label("unit").nth(3).select_option("MPa")
    page.get_by_role("alert").get_by_text("do not belong together").wait_for()
    page.get_by_label("unit").nth(3).select_option("kN")
    page.get_by_text("found no doubts").wait_for()

    assert other.get_by_text("found no doubts").count() == 0
    drop(other, ("second.csv", "text/csv", RAW))
    other.get_by_text("found no doubts").wait_for()
    go.click()
    page.get_by_text("Fit a model to raw").wait_for()
    assert read_campaign(root / "raw")["raw"].record["force"].max() > 8e4
    assert other.get_by_text("Fit a model to raw").count() == 0
    assert not (root / "second" / "campaign.yaml").exists()


# As they come, one after the other and each some time after the last one.
ARRIVING = [("campaign.yaml", "experiments.csv", "E01.csv"), ("E01.csv", "experiments.csv", "campaign.yaml"),
            ("experiments.csv", "E01.csv", "campaign.yaml")]  # fmt: skip


@pytest.mark.whole
@pytest.mark.parametrize("order", ARRIVING, ids=" ".join)
def test_the_files_of_a_campaign_come_when_they_come(server, opened, order):
    files = campaign_files({"E01": ""})
    page, before = opened(server), set(server.root.iterdir())
    for name in order:
        drop(page, (name, "text/plain", files[name].decode()))
        page.wait_for_timeout(1500)
    page.get_by_text("1 record of").wait_for()
    (made,) = set(server.root.iterdir()) - before
    assert [e.id for e in read_campaign(made)] == ["E01"]


@pytest.mark.whole
def test_a_record_that_is_none_is_said_and_the_page_goes_on(server, opened):
    page = opened(server)
    drop(page, ("one_row.csv", "text/csv", 't,u,F\n1,2,"x"\n'))
    page.get_by_role("alert").get_by_text("row 2, column 'F': 'x' is not a number").wait_for()
    page.get_by_label("column of the force").select_option("(none)")
    page.get_by_role("alert").get_by_text("choose the column of the force").wait_for()
    page = opened(server)
    drop(page, ("spoilt.csv", "text/csv", SPOILT["an error of a spreadsheet"][0]))
    page.get_by_role("alert").get_by_text("'#N/A' is an error of the spreadsheet").wait_for()
    assert page.get_by_label("column of the force").input_value() == "F"


@pytest.mark.whole
def test_a_run_that_there_is_can_be_played_with(server, opened):
    page = opened(server)
    page.get_by_label("run", exact=True).select_option("runs/column")
    part(page, "3 Report")
    page.frame_locator("iframe").get_by_text("a report").wait_for()
    part(page, "4 Effects")
    page.get_by_text("with yield sharpness").wait_for()
    assert error_of(page, "with yield sharpness") < 0.002
    page.get_by_label("stiffness degradation").check()
    page.get_by_text("and stiffness degradation").wait_for()
    before = error_of(page, "and stiffness degradation")
    assert before > 0.05
    page.locator(".noUi-handle").nth(2).press("ArrowLeft")
    page.wait_for_function("before => !document.body.innerText.includes(before)", arg=f"{before:.3f}")
    part(page, "5 Next experiment")
    page.get_by_text("There is no design among the steps").wait_for()
    part(page, "6 Download")
    with page.expect_download() as download:
        page.get_by_role("link", name="study.yaml").click()
    assert Path(download.value.path()).read_text() == (server.root / "runs" / "column" / "study.yaml").read_text()


def error_of(page, after):
    return float(page.locator("p", has_text=after).locator("b").inner_text())


def test_a_tab_that_is_closed_while_the_server_writes_to_it_is_no_fault(caplog):
    pytest.importorskip("panel")
    from tornado.websocket import WebSocketClosedError

    from hsed_jax.app.server import say_unless_tab_closed

    async def failing(error):
        raise error

    async def with_lost_tasks():
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(say_unless_tab_closed)
        errors = (WebSocketClosedError(), ValueError("a fault of the page"))
        lost = [loop.create_task(failing(error)) for error in errors]
        await asyncio.wait(lost)
        lost.clear()
        gc.collect()

    asyncio.run(with_lost_tasks())
    (said,) = caplog.records
    assert isinstance(said.exc_info[1], ValueError)


@pytest.mark.slow
def test_from_a_raw_file_to_a_named_effect(served, opened, tmp_path):
    server = served(tmp_path)
    page = opened(server)
    page.set_default_timeout(900_000)
    drop(page, ("column.csv", "text/csv", RAW))
    page.get_by_label("keep the last third").uncheck()
    page.get_by_role("button", name="Continue with these measurements").click()
    page.get_by_text("Fit a model to column").wait_for()
    go, stop = page.get_by_role("button", name="Go", exact=True), page.get_by_role("button", name="Stop")
    go.click()
    page.locator("p", has_text="calibrate").first.wait_for()
    stop.click()
    page.get_by_text("nothing is lost").wait_for()
    page.get_by_role("button", name="Go on where it stopped").click()
    report = page.frame_locator("iframe")
    report.locator("#sentence", has_text="Missing is stiffness_degradation").wait_for()

    part(page, "4 Effects")
    page.get_by_text("with stiffness degradation").wait_for()
    assert error_of(page, "with stiffness degradation") < 0.02
    page.get_by_label("stiffness degradation").uncheck()
    page.get_by_text("with no effect").wait_for()
    assert error_of(page, "with no effect") > 0.1

    part(page, "6 Download")
    with page.expect_download() as download:
        page.get_by_role("link", name="improved.yaml").click()
    kept = tmp_path / "runs" / "column"
    assert Path(download.value.path()).read_text() == (kept / "improved.yaml").read_text()
    summary = json.loads((kept / "summary.json").read_text())
    assert summary["diagnosis"]["effects"] == ["stiffness_degradation"]
    # The law's own numbers and the effect's, as the specimen has them; SI.
    found = summary["improvement"]["map"]
    assert found["A"] == pytest.approx(1e6 * A, rel=0.02)
    assert found["beta"] == pytest.approx(1e3 * BETA, rel=0.02)
    assert {path.name for path in tmp_path.iterdir()} == {"column", "runs", "said.txt"}


PLAN = """
study: plan
excitation:
  imposed: {amplitudes: [5.0e-3, a], cycles: 1, rate: 0.05}
inputs: {a: {uniform: [15.0, 60.0], unit: mm}}
model: {spring: bilinear, parameters: {k: {uniform: [2.0e6, 9.0e6]}, F_y: {uniform: [2.0e4, 6.0e4]}}}
experiments:
  folder:
    channels: {time: {column: t, unit: s}, elongation: {column: u, unit: mm}, force: {column: F, unit: kN}}
observe: histories
error: {relative: 0.05}
steps: [design, calibrate]
design: {initial: 3, iterations: 1, candidates: 64}
"""


@pytest.mark.slow
def test_a_design_is_asked_and_told(served, opened, tmp_path):
    (tmp_path / "plan.yaml").write_text(PLAN)
    page = opened(served(tmp_path))
    page.set_default_timeout(300_000)
    part(page, "5 Next experiment")
    page.get_by_role("button", name="Ask for the next experiment").click()
    page.locator("pre", has_text="E01: a").wait_for()
    request = tmp_path / "runs" / "plan" / "laboratory" / "E01-1"
    imposed = pd.read_csv(request / "imposed_elongation.csv", comment="#")
    time, u = imposed.iloc[:, 0], imposed.iloc[:, 1]
    record = pd.DataFrame({"t": time, "u": 1e3 * u, "F": np.clip(4e3 * u, -40, 40)}).to_csv(index=False)
    page.locator("input[type=file]").last.set_input_files(
        {"name": "E01.csv", "mimeType": "text/csv", "buffer": record.encode()}
    )
    page.locator("pre", has_text="1 completed").wait_for()
    campaign = read_campaign(tmp_path / "runs" / "plan" / "campaign")
    # On the design's own grid, which is coarser.
    told = campaign["E01"].record
    assert_allclose(told["elongation"].max(), u.max(), rtol=1e-4)
    assert_allclose(told["force"], np.clip(4e6 * told["elongation"], -4e4, 4e4), atol=1.0)
    page.get_by_role("button", name="Ask for the next experiment").click()
    page.locator("pre", has_text="E02: a").wait_for()
