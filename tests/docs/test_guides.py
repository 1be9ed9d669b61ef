"""The guides begin with raw files and two small texts: these are read, and what the check prints is what the page shows."""

import re
from pathlib import Path

import pytest
from builders.places import ROOT

from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.study.build import Built

DOCS = ROOT / "docs"


@pytest.fixture
def cases(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    import guide_cases

    return guide_cases


def block(page: str, begins: str) -> str:
    """The one block of a page that begins so."""
    text = (DOCS / f"guide_{page}.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"^```(?:yaml)?\n({re.escape(begins)}.*?)```$", text, re.MULTILINE | re.DOTALL)
    return found


@pytest.mark.whole
@pytest.mark.parametrize(
    ("case", "page", "table"),
    [
        ("column", "cyclic_test", "id,record,split"),
        ("frame", "shake_table", "id,record,split"),
        ("coupons", "coupons", None),
    ],
)
def test_the_raw_files_and_the_texts_of_a_guide_are_a_campaign(cases, tmp_path, monkeypatch, capsys, case, page, table):
    monkeypatch.chdir(tmp_path)
    folder = Path("cases") / case
    getattr(cases, case)(folder)
    (folder / "campaign.yaml").write_text(block(page, "# campaign.yaml"))
    if table:
        (folder / "experiments.csv").write_text(block(page, table))
    assert main(["init", str(folder)]) == 0
    capsys.readouterr()
    assert main(["check", str(folder / "study.yaml")]) == 0
    said = capsys.readouterr().out
    # The later cycles of the column are larger than those that are fitted, and the guide says so.
    doubts = [line for line in said.splitlines() if line.startswith("doubt")]
    assert (
        "the study is valid" in said and len(doubts) == (case == "column") and all("beyond" in line for line in doubts)
    )
    if case == "column":
        shown = block(page, "doubt: later_cycles")
        # What it would cost is this machine's.
        assert [line for line in shown.splitlines() if "expect" not in line] == [
            line for line in said.splitlines() if "expect" not in line
        ]
    if case == "frame":
        assert block(page, "structure:").strip() in (folder / "study.yaml").read_text()


def test_the_study_of_the_hybrid_simulation_is_valid(tmp_path):
    (tmp_path / "study.yaml").write_text(block("hybrid_simulation", "# study.yaml"))
    Built(load_study(tmp_path / "study.yaml")).check()
