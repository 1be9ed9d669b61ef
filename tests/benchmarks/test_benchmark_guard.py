"""The guard of the benchmarks tells what grew from what did not, on invented results."""

import json
import sys
from pathlib import Path

import pytest
import run
from guard import ERROR_FACTOR, ERRORS, FACTOR, grown, guarded, uncompared
from measure import line


def results(ours=2.0, c=1.0, peaks=1e-4, row="simulate", work="a batch", **figures):
    return [line(row, work, "s", ours, {"C": c}, {"ours": {"peaks": peaks, **figures}})]


def test_the_rows_are_those_of_the_folder():
    folder = Path(run.__file__).parent / "rows"
    assert sorted(run.ROWS) == sorted(path.stem for path in folder.glob("*.py"))


def test_the_same_results_have_not_grown():
    assert grown(results(), results()) == uncompared(results(), results(), ["simulate"]) == []


def test_a_ratio_that_grew_is_told_with_both_costs():
    (found,) = grown(results(), results(ours=3.0))
    assert found[:3] == ("simulate", "a batch", "ratio to C")
    assert found.sentence == (
        "simulate, a batch: 1.50 times the kept ratio to C, 2 → 3; at most 1.3 times is allowed (ours 2 → 3 and C 1 → 1 s)"
    )


def test_seconds_are_not_compared_and_a_ratio_may_grow_a_little():
    assert grown(results(), results(ours=20.0, c=10.0)) == []
    assert grown(results(), results(ours=2.0 * 0.99 * FACTOR)) == []


def test_what_is_no_number_has_grown():
    assert len(grown(results(), results(ours=float("nan"), peaks=float("nan")))) == 2


def test_an_error_that_grew_is_told_unless_it_is_rounding():
    (found,) = grown(results(), results(peaks=4e-4))
    assert found.what == "error of peaks"
    assert "grew from 0.0001 to 0.0004" in found.sentence
    assert grown(results(peaks=1e-16), results(peaks=0.9 * ERROR_FACTOR * ERRORS["peaks"])) == []


def test_figures_that_are_no_errors_are_not_compared():
    few, many = results(**{"effective samples": 10}), results(**{"effective samples": 1000})
    assert grown(few, many) == grown(many, few) == []


def test_what_only_one_has_is_named():
    kept = [*results(), *results(work="gone"), *results(row="sweep")]
    now = [*results(), *results(work="new")]
    assert uncompared(kept, now, ["simulate"]) == [
        "simulate, new: measured now, but not kept",
        "simulate, gone: kept, but not measured now",
    ]


def test_a_peer_or_an_error_that_only_one_has_is_named():
    kept = [line("simulate", "a batch", "s", 2.0, {"C": 1.0, "numba": 4.0})]
    now = [line("simulate", "a batch", "s", 2.0, {"C": 1.0, "Fortran": 1.0}, {"ours": {"energy": 0.0, "draws": 3}})]
    assert uncompared(kept, now, ["simulate"]) == [
        "simulate, a batch: the ratio to Fortran is measured now, but not kept",
        "simulate, a batch: the error of 'energy' is measured now, but not kept",
        "simulate, a batch: the ratio to numba is kept, but not measured now",
    ]


def test_only_what_grew_twice_has_grown_and_only_its_row_is_measured_twice():
    kept = [*results(), *results(work="alone"), *results(row="kriging")]
    runs = iter(
        [
            [*results(ours=3.0), *results(work="alone", ours=3.0), *results(row="kriging")],
            [*results(ours=4.0), *results(work="alone")],
        ]
    )
    measured = []

    def measure(rows):
        measured.append(list(rows))
        return next(runs)

    (sentence,), apart = guarded(kept, measure, ["simulate", "kriging"])
    assert sentence.startswith("simulate, a batch: 2.00 times")
    assert apart == []
    assert measured == [["simulate", "kriging"], ["simulate"]]


def test_to_compare_nothing_is_no_success():
    found, _ = guarded(results(), lambda rows: results(work="another"), ["simulate"])
    assert found == ["nothing was compared: no line is both kept and measured now"]


@pytest.mark.parametrize(("ours", "status", "said"), [(2.0, 0, "no ratio and no error has grown"), (3.0, 1, "grown: ")])
def test_the_command_says_it_by_its_exit_and_keeps_nothing(monkeypatch, capsys, tmp_path, ours, status, said):
    kept = tmp_path / "results.json"
    kept.write_text(json.dumps({"lines": results()}), encoding="utf-8")
    before = kept.read_bytes()
    monkeypatch.setattr(run, "measured", lambda row, quick: results(ours=ours))
    monkeypatch.setattr(sys, "argv", ["run.py", "simulate", "--guard", "--output", str(kept)])
    with pytest.raises(SystemExit) as end:
        run.main()
    assert end.value.code == status
    assert said in capsys.readouterr().out
    assert kept.read_bytes() == before
