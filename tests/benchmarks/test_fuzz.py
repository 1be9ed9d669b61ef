"""A sample of `benchmarks/fuzz.py`, and that it sees what it looks for."""

import fuzz
import pytest

from hsed_jax.intake.found import Found
from hsed_jax.intake.opening import Opened

pytest.importorskip("panel")
pytest.importorskip("openpyxl")
EVERY = (*fuzz.FORMATS, *fuzz.TABLES)


@pytest.mark.parametrize("number", range(2 * len(EVERY)), ids=lambda number: f"{EVERY[number % len(EVERY)]} {number}")
def test_a_mutated_file_is_read_or_refused_in_one_message(tmp_path, number):
    assert fuzz.wrong(fuzz.file_case(number, 2026, tmp_path) | {"bytes": 0, "seconds": 0.0}) == []


@pytest.fixture
def whole(monkeypatch):
    """Files that nothing is wrong with."""
    monkeypatch.setattr(fuzz, "mutated", lambda draw, content: content)
    monkeypatch.setattr(fuzz, "spoilt", lambda draw, name: (fuzz.written(name, fuzz.columns()), fuzz.columns()))
    monkeypatch.setattr(fuzz, "within_archive", lambda draw, content: content)


@pytest.mark.parametrize("number", range(len(EVERY)), ids=lambda number: EVERY[number])
def test_a_whole_file_is_read(tmp_path, whole, number):
    found = fuzz.file_case(number, 0, tmp_path)
    # A campaign has no workbooks, and a ground motion is no test of a specimen.
    if EVERY[number] in ("a.xlsx", "a.at2"):
        assert found.pop("command") == "refused"
    if EVERY[number] == "a.at2":
        assert found.pop("page") == "refused"
    assert set(found.values()) == {EVERY[number], "read"}


def test_it_sees_a_traceback_another_column_other_numbers_and_too_much_memory(tmp_path, whole, monkeypatch):
    from hsed_jax.intake import opening, words

    table = fuzz.columns()
    content = fuzz.written("comma.csv", table)
    read = opening.opened_file

    def page(number):
        folder = tmp_path / str(number)
        folder.mkdir()
        return fuzz.paged(folder, "a.csv", content, table)

    assert page(0) == "read"
    monkeypatch.setattr(opening, "opened_file", lambda path: {}["x"])
    assert page(1) == "KeyError: 'x'"

    def doubled(path):
        (found,) = read(path).tables.values()
        return Opened({"": Found(found.columns | {"u2": 2 * found.columns["u2"]}, found.faults, found.names)}, [])

    monkeypatch.setattr(opening, "opened_file", doubled)
    assert page(2) == "SILENT: column u2 is read as other numbers"
    monkeypatch.setattr(opening, "opened_file", read)
    monkeypatch.setitem(words._SYMBOLS, "force", "u2")
    assert page(3) == "SILENT: u2 is taken for the force, which is F"
    assert fuzz.wrong({"reader": "read", "bytes": 2 * 10**9, "seconds": 100.0}) == ["2.00 GB", "100 s"]


@pytest.mark.whole
def test_a_mutated_run_folder_makes_a_result_or_one_message(tmp_path_factory):
    run = fuzz.finished(tmp_path_factory.mktemp("finished"))
    found = dict(fuzz.cases("runs", range(len(fuzz.PARTS)), 2026, run))
    wrong = {number: fuzz.wrong(case | {"bytes": 0, "seconds": 0.0}) for number, case in found.items()}
    assert not any(wrong.values()), wrong
