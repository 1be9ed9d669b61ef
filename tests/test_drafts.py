"""Files are written whole, and never through a symbolic link."""

import ast
import os
import stat

import pytest
import xarray as xr
from builders import run_folders
from builders.places import ROOT
from matplotlib.figure import Figure

from hsed_jax.command_line import main
from hsed_jax.drafts import create, extend, write_netcdf, write_whole
from hsed_jax.errors import UserError
from hsed_jax.reporting.style import Picture, save
from hsed_jax.runs.folder import RunFolder
from hsed_jax.sweeps.folder import SweepFolder, note
from hsed_jax.sweeps.plan import Plan

PACKAGE = ROOT / "hsed_jax"
STUDY = {"study": "x", "seed": 0}
MINE = b"what somebody wrote for hours"


@pytest.fixture
def mine(tmp_path):
    """A file outside the run folder."""
    file = tmp_path / "mine.txt"
    file.write_bytes(MINE)
    return file


def test_a_draft_and_a_file_that_are_links_are_replaced_and_what_they_lead_to_is_not(tmp_path, mine):
    for name in ("x.txt", "x.txt.part", "x.nc", "x.nc.part", "f.svg", "f.png", "new"):
        (tmp_path / name).symlink_to(mine)
    write_whole(tmp_path / "x.txt", "text")
    write_netcdf(tmp_path / "x.nc", xr.Dataset({"a": 1.0}))
    figure = Figure(layout="constrained")
    figure.subplots()
    save(Picture(figure, "caption", "words"), tmp_path, "f")
    with create(tmp_path / "new") as file:
        file.write(b"1")
    assert mine.read_bytes() == MINE
    assert (tmp_path / "x.txt").read_text() == "text" and not (tmp_path / "x.txt").is_symlink()
    assert not list(tmp_path.glob("*.part"))


def test_a_draft_that_is_a_hard_link_or_a_pipe_is_replaced(tmp_path, mine):
    os.link(mine, tmp_path / "x.txt.part")
    write_whole(tmp_path / "x.txt", "text")
    os.mkfifo(tmp_path / "y.txt.part")
    write_whole(tmp_path / "y.txt", "text")
    assert mine.read_bytes() == MINE and (tmp_path / "y.txt").read_text() == "text"


def test_a_file_that_is_extended_is_no_link(tmp_path, mine):
    (tmp_path / "link").symlink_to(mine)
    with pytest.raises(OSError, match="symbolic links"):
        extend(tmp_path / "link")
    assert mine.read_bytes() == MINE


def test_a_new_file_has_the_permissions_that_the_user_set(tmp_path):
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "x.txt", "text")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "x.txt").stat().st_mode) == 0o640


# A file or folder that leads elsewhere, by what a run leaves there.
FILES = (".lock", "journal.jsonl", "study.yaml", "provenance.json", "summary.json", "results.nc", "report.html", "improved.yaml",
         "learned_effect.py", "report.html.part", "summary.json.part", "study.yaml.part", "campaign/campaign.yaml",
         "campaign/records/E01.csv", "figures/cycles.svg", "reached/fit.part", "export/specimen.py")  # fmt: skip
FOLDERS = ("campaign", "campaign/records", "figures", "reached", "export", "laboratory", "laboratory/E01-1")


@pytest.mark.parametrize("name", FILES + FOLDERS)
@pytest.mark.parametrize("how", ["resume", "force"])
def test_a_run_in_a_folder_with_a_link_is_refused_and_nothing_is_written_elsewhere(tmp_path, mine, name, how):
    run = tmp_path / "run"
    RunFolder(run, STUDY).close()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    link = run / name
    link.parent.mkdir(parents=True, exist_ok=True)
    link.unlink(missing_ok=True)
    link.symlink_to(mine if name in FILES else elsewhere)
    with pytest.raises(UserError, match="is a symbolic link"):
        RunFolder(run, STUDY, resume=how == "resume", force=how == "force")
    assert mine.read_bytes() == MINE and not list(elsewhere.iterdir())


def test_a_run_folder_that_is_itself_a_link_and_a_record_of_a_laboratory_that_is_one_are_taken(tmp_path, mine):
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "disk")
    store = RunFolder(tmp_path / "run", STUDY)
    (store.laboratory / "E01-1").mkdir(parents=True)
    (store.laboratory / "E01-1" / "record.csv").symlink_to(mine)
    store.close()
    RunFolder(tmp_path / "run", STUDY, resume=True).close()


@pytest.mark.parametrize("name", [".lock", "sweep.yaml", "outcomes/0001.json", "outcomes/0001.lock", "runs/0001"])
def test_a_sweep_in_a_folder_with_a_link_is_refused(tmp_path, mine, name):
    folder = SweepFolder(tmp_path / "sweep", Plan(STUDY, ({"seed": 1},)), resume=False, force=False)
    note(folder.path, 0, {"status": "pending"})
    folder.close()
    link = folder.path / name
    link.unlink(missing_ok=True)
    link.symlink_to(mine)
    with pytest.raises(UserError, match="is a symbolic link"):
        SweepFolder(tmp_path / "sweep", None, resume=True, force=False)
    assert mine.read_bytes() == MINE


@pytest.mark.whole
def test_a_report_of_a_folder_with_links_overwrites_nothing_outside(tmp_path, mine, capsys):
    run = run_folders.write(tmp_path / "run")
    (run / "report.html.part").symlink_to(mine)
    assert main(["report", str(run)]) == 0
    assert mine.read_bytes() == MINE
    (run / "report.html").unlink()
    (run / "report.html").symlink_to(mine)
    assert main(["report", str(run)]) == 2 and "is not a report" in capsys.readouterr().err
    assert mine.read_bytes() == MINE


def test_an_export_is_not_written_through_a_link(tmp_path, capsys, monkeypatch):
    run = tmp_path / "run"
    run.mkdir()
    (tmp_path / "elsewhere").mkdir()
    (run / "export").symlink_to(tmp_path / "elsewhere")
    monkeypatch.setattr("hsed_jax.exports.export.calibrated", lambda *arguments, **settings: None)
    monkeypatch.setattr("hsed_jax.exports.export._files", lambda model, kind: {"specimen.py": ""})
    assert main(["export", str(run), "--opensees"]) == 2
    assert "is a symbolic link" in capsys.readouterr().err and not list((tmp_path / "elsewhere").iterdir())


# Calls that write where a path leads, be it through a link; text and tables made in memory are written by `drafts`.
WRITING = {"write_text", "write_bytes", "to_csv", "to_parquet", "to_netcdf", "savefig", "savez", "save_netcdf", "open"}
# A program of its own in a new folder of OpenSees.
APART = {"laboratories/opensees_model.py"}


def opened_for_writing(source: str) -> list[int]:
    """Lines of a module that write a file without `drafts`."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        words = [a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
        if called == "open":
            if any(set(word) <= set("wxab+t") and set(word) & set("wxa") for word in words):
                found.append(node.lineno)
        elif called in ("savefig", "savez"):
            # Into a file that is open, or into memory.
            if not (isinstance(node.args[0], ast.Name) and node.args[0].id in ("file", "buffer")):
                found.append(node.lineno)
        elif called in WRITING and (node.args or called in ("write_text", "write_bytes")):
            found.append(node.lineno)
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_every_file_is_written_by_drafts(path):
    if str(path.relative_to(PACKAGE)) not in APART:
        assert opened_for_writing(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "source", ["p.write_text(x)", "p.open('w')", "open(p, 'wb')", "t.to_csv(p)", "f.savefig(p / 'x')"]
)
def test_the_checker_catches_what_writes_where_a_link_leads(source):
    assert opened_for_writing(source) == [1]


def test_the_checker_passes_what_only_reads():
    assert (
        opened_for_writing("p.open('rb')\nopen(p)\nt.to_csv(index=False)\nf.savefig(buffer)\nwrite_whole(p, t)") == []
    )
