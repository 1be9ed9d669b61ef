"""`hsed init FILE` and `hsed run FILE`: the campaign, the study and the picture of a file; `--force`; the page makes the same."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from builders.places import SHARED

from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.drafting.floors import floors_of
from hsed_jax.measurements import read_campaign
from hsed_jax.reporting.loops import sketch
from hsed_jax.runs.beginning import ParserOfFiles, add_force, files_of
from hsed_jax.study.advice import frequency_doubts
from hsed_jax.study.build import Built

SAMPLES = 300
U = np.round(0.1 * np.arange(SAMPLES) * np.sin(0.2 * np.arange(SAMPLES)), 3)
F = np.round(40 * np.tanh(U / 5) + 2 * np.roll(U, 1), 3)
WALL = "Test unit,C2\nReference,L (2014)\ntop_displacement,horizontal_force,drift\n[mm],[kN],[%]\n"
WALL += "".join(f"{u},{f},{u / 25:.4f}\n" for u, f in zip(U, F, strict=True))


@pytest.fixture
def wall(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "wall.csv"
    path.write_text(WALL)
    return path


def test_a_file_becomes_a_campaign_a_study_and_a_picture(wall, capsys):
    assert main(["init", "wall.csv"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"elongation: column 'top_displacement [mm]', {U.min():.6g} to {U.max():.6g} mm"
    assert said[1] == f"force:      column 'horizontal_force [kN]', {F.min():.6g} to {F.max():.6g} kN"
    assert said[2] == "time:       no column of the file; samples are numbered"
    assert said[3] == "note: not used: 'drift [%]'"
    assert said[-1] == "wrote wall/study.yaml; run it with: hsed run wall/study.yaml"
    train, test = read_campaign("wall")
    np.testing.assert_allclose(train.record["force"], 1e3 * F, rtol=1e-12)
    assert (train.split, train.window, test.split, test.window) == ("train", (0, 199), "test", (200, 299))
    assert sorted(path.name for path in Path("wall").iterdir()) == [
        "campaign.yaml", "experiments.csv", "figures", "loops.png", "records", "study.yaml"]  # fmt: skip
    assert Path("wall/loops.png").read_bytes().startswith(b"\x89PNG")
    # Its work is negative: that is doubted, and drawn beside the study.
    assert said[-2] == "wall: the picture wall/figures/doubts_wall.png marks the doubtful samples"
    assert Path("wall/figures/doubts_wall.png").read_bytes().startswith(b"\x89PNG")
    text = Path("wall/study.yaml").read_text()
    assert "# Made of wall.csv:\n#   elongation: column 'top_displacement [mm]'" in text
    Built(load_study("wall/study.yaml")).check()


def test_a_file_is_checked_and_nothing_is_written(wall, capsys):
    before = sorted(wall.parent.iterdir())
    assert main(["check", "wall.csv"]) == 0
    checked = capsys.readouterr().out
    assert sorted(wall.parent.iterdir()) == before
    assert main(["init", "wall.csv"]) == 0
    # What it says is what is said when the study is made.
    assert checked.strip() and checked.strip() in capsys.readouterr().out
    assert main(["check", "wall.csv", "--force", "nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err


@pytest.mark.whole
def test_what_is_there_is_replaced_only_by_force_and_the_column_of_the_force_is_said_by_it(wall, capsys):
    assert main(["init", "wall.csv", "--split", "0"]) == 0
    assert main(["init", "wall.csv"]) == 2
    assert "wall exists already; run its study with: hsed run wall/study.yaml" in capsys.readouterr().err
    assert main(["run", "wall.csv"]) == 2
    assert "wall exists already" in capsys.readouterr().err
    assert len(read_campaign("wall")) == 1
    assert main(["init", "--force", "wall.csv"]) == 0
    assert len(read_campaign("wall")) == 2
    # By the name of a column, in front of the file and behind it.
    wall.write_text(WALL.replace("horizontal_force", "CH7").replace("drift", "CH8").replace("[%]", "[kN]"))
    assert main(["init", "wall.csv", "--force"]) == 2
    assert "the column of the force ('CH7 [kN]', 'CH8 [kN]' may be it)" in capsys.readouterr().err
    for words in (["--force", "CH7 [kN]", "wall.csv", "--force"], ["wall.csv", "--force=CH7", "--force"]):
        assert main(["init", *words]) == 0
        np.testing.assert_allclose(read_campaign("wall")["wall"].record["force"], 1e3 * F, rtol=1e-12)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["wall.csv", "--elongation", "nothing"],
            "there is no column 'nothing'; the columns are 'top_displacement [mm]'",
        ),
        (["wall.csv", "--unit", "drift"], "--unit drift: write COLUMN=UNIT"),
        (["wall.csv", "--unit", "force=parsec"], "force"),
        (["wall.csv", "--split", "1.5"], "--split 1.5: write the share"),
        (["wall.csv", "--missing", "x"], "--missing x: write a number"),
        (["nowhere.csv"], "nowhere.csv: cannot be read"),
        (["wall.csv", "wall.xyz"], "give either one folder of a campaign, or files"),
        (["nowhere"], "nowhere: no such folder"),
        (["wall.csv", "--masses", "1"], "masses are of a shaken frame"),
    ],
)
def test_a_mistake_is_one_message_and_leaves_nothing(wall, capsys, words, message):
    assert main(["init", *words]) == 2
    assert message in capsys.readouterr().err
    assert not Path("wall/study.yaml").exists()


def test_flags_of_files_are_none_of_a_campaign(wall, capsys):
    assert main(["init", "wall.csv"]) == 0
    assert main(["init", "wall", "--force", "--unit", "force=N"]) == 2
    assert "--unit is an option for files" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "force", "column"),
    [
        (["a.csv"], False, None),
        (["a.csv", "--force"], True, None),
        (["--force", "study.yaml"], True, None),
        (["--force", "F [kN]", "a.csv"], False, "F [kN]"),
        (["a.csv", "--force", "- a1 - a2"], False, "- a1 - a2"),
        (["--force", "steps=[calibrate]", "study.yaml"], True, None),
    ],
)
def test_force_alone_replaces_and_with_a_column_names_it(words, force, column):
    parser = ParserOfFiles()
    parser.add_argument("words", nargs="+")
    add_force(parser, "replace")
    options = parser.parse_args(words)
    assert (options.force, options.force_column) == (force, column)


def test_files_are_told_from_studies_folders_and_keys(wall):
    Path("folder.csv").mkdir()
    assert files_of(["wall.csv", "s.yaml", "folder.csv", "a.b=3", "gone.mat", "no_such_folder"]) == [
        Path("wall.csv"),
        Path("gone.mat"),
    ]


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of the widgets of panel
def test_the_page_makes_the_same_campaign_of_a_file(wall):
    pytest.importorskip("panel")
    from hsed_jax.app.folder import Folder
    from hsed_jax.app.jobs import Jobs
    from hsed_jax.app.measured import Measured
    from hsed_jax.app.session import Session

    assert main(["init", "wall.csv"]) == 0
    folder = Folder(wall.parent)
    page = Measured(Session(folder, Jobs(wall.parent)))
    found, _ = page._land({"wall.csv": wall.read_bytes()})
    page._show(found, None)
    assert page._campaign is not None
    command = read_campaign("wall")
    assert [(e.id, e.split, e.window) for e in page._campaign] == [(e.id, e.split, e.window) for e in command]
    assert all(one.record == other.record for one, other in zip(page._campaign, command, strict=True))
    assert page._campaign.channels == {n: c for n, c in command.channels.items()}


def test_a_sketch_shows_the_loops_where_they_are(wall):
    main(["init", "wall.csv"])
    lines = sketch(read_campaign("wall"), width=20, height=6).splitlines()
    assert len(lines) == 7 and {len(line) for line in lines[:6]} == {20}
    # A loop from lower left to upper right: nothing in the other corners.
    assert lines[0][0] == lines[5][-1] == "\u2800"
    assert lines[0][-1] != "\u2800" and lines[5][0] != "\u2800"
    assert f"{U.max():.4g} mm across" in lines[6]


FRAME = """name: frame
protocol: ground_motion
channels:
  time: {column: t, unit: s}
  ground_acceleration: {column: ag, unit: m/s^2}
  acceleration_1_absolute: {column: a1, unit: m/s^2}
  acceleration_2_absolute: {column: a2, unit: m/s^2}
"""
MASSES, STOREY = np.array([22118.0, 18810.0]), 1.5e7


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    """A frame of two elastic storeys of one stiffness with the masses above, shaken by a noise in steps, solved exactly."""
    folder = tmp_path_factory.mktemp("made") / "frame"
    (folder / "records").mkdir(parents=True)
    time = 0.01 * np.arange(3000)
    ground = np.random.default_rng(1).standard_normal(time.size)
    stiffness = STOREY * np.array([[2.0, -1.0], [-1.0, 1.0]])
    state, rows = np.zeros(4), []
    damping = 0.0008 * stiffness
    inverse = np.diag(1 / MASSES)
    system = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    from scipy.linalg import expm

    step = expm(np.block([[system, np.array([[0.0], [0], [-1], [-1]])], [np.zeros((1, 5))]]) * 0.01)
    for a in ground:
        rows.append((system @ state)[2:])
        state = step[:4, :4] @ state + step[:4, 4] * a
    table = np.column_stack([time, ground, np.array(rows)])
    np.savetxt(folder / "records" / "E1.csv", table, delimiter=",", header="t,ag,a1,a2", comments="")
    (folder / "campaign.yaml").write_text(FRAME)
    (folder / "experiments.csv").write_text("id,record\nE1,records/E1.csv\n")
    frequency = np.sqrt(np.linalg.eigvalsh(np.diag(MASSES**-0.5) @ stiffness @ np.diag(MASSES**-0.5))[0]) / (2 * np.pi)
    return folder, frequency


@pytest.mark.parametrize("height", [None, "3.2"])
def test_masses_of_a_frame_bring_the_priors_with_them(frame, height, tmp_path, capsys):
    folder, frequency = frame
    study = tmp_path / "study.yaml"
    words = ["--masses", "22118,18810", *(["--height", height] if height else [])]
    assert main(["init", str(folder), "--output", str(study), *words]) == 0
    told = load_study(study)
    assert told.structure.masses == [22118, 18810]
    floors = floors_of(read_campaign(folder), tuple(MASSES))
    assert floors.frequency == pytest.approx(frequency, rel=0.05)
    assert floors.stiffness * MASSES.mean() == pytest.approx(STOREY, rel=0.1)
    gravity = MASSES.sum() * 9.80665 / 3.2 if height else 0.0
    assert np.exp(told.model.parameters["A"]["lognormal"][0]) == pytest.approx(
        floors.stiffness * MASSES.mean() + gravity, rel=1e-3
    )
    effects = {"hardening": {"k": pytest.approx(-gravity, rel=1e-3)}} if height else {}
    assert told.model.effects == effects
    built = Built(told)
    built.check()
    assert frequency_doubts(built.mechanics, built.experiments.measured) == []
    # A mass that is changed alone is doubted, with the prior to write.
    study.write_text(study.read_text().replace("[22118, 18810]", "[221180, 188100]"))
    assert main(["check", str(study)]) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "other masses need other stiffnesses" in line)
    assert re.search(r"such as A: \{lognormal: \[", line)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--masses", "22118"], "sensors are on 2 floors, and 1 masses are given"),
        (["--masses", "22118,0"], "greater than zero"),
        (["--masses", "heavy,light"], "write numbers in kg"),
        (["--height", "3.2"], "--height needs --masses"),
    ],
)
def test_a_frame_that_cannot_be_is_refused(frame, tmp_path, words, message, capsys):
    assert main(["init", str(frame[0]), "--output", str(tmp_path / "s.yaml"), *words]) == 2
    assert message in capsys.readouterr().err


WALLS = SHARED / "data/stone_masonry/curves"


@pytest.mark.whole
@pytest.mark.skipif(not WALLS.exists(), reason="the curves of the stone masonry walls are not there")
def test_from_a_raw_curve_to_a_report_in_one_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(WALLS / "FD_WI3175_Vasconcelos2009.csv", "wall.csv")
    assert main(["run", "wall.csv", "steps=[calibrate, compare]"]) == 0
    assert Path("runs/wall/report.html").exists() and Path("wall/loops.png").exists()
