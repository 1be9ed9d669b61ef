"""The scoreboard of measured specimens: its simulators, its splits, that no method sees what it predicts, and its page."""

import json

import numpy as np
import published
import pytest
from board import hysteresis, records, table
from board.comparisons import METHODS
from board.page import text
from builders.places import ROOT
from scipy.integrate import solve_ivp

import hsed_jax as hx


def growing(rows=240, cycles=6):
    """An elongation [m] of cycles that grow from zero."""
    phase = np.linspace(0, 2 * np.pi * cycles, rows)
    return 0.02 * np.linspace(0.2, 1.0, rows) * np.sin(phase)


def trial(force, elongation=None, held=None):
    u = growing() if elongation is None else elongation
    held = np.arange(len(u)) >= 2 * len(u) // 3 if held is None else held
    return records.Test(u, force, ~held, held)


def test_the_plain_law_loads_as_its_closed_form():
    u = np.linspace(0.0, 1.0, 200)
    parameters = {**hysteresis.PLAIN, "kappa": 8.0, "strength": 0.7}
    (force,) = hysteresis.simulated(parameters, [trial(np.ones(200), u, np.zeros(200, bool))])
    assert force == pytest.approx(0.7 * (1 - np.exp(-8.0 * u / 0.7)), abs=2e-4)


DEGRADING = {"kappa": 6.0, "strength": 0.8, "rho": 0.1, "b": 0.7, "n": 1.6, "delta_nu": 0.04, "delta_eta": 0.06, "zeta_s": 0.9,
             "p": 1.5, "q": 0.15, "psi": 0.3, "delta_psi": 0.02, "lambda": 0.4}  # fmt: skip


def integrated(u, p):
    """The law of Baber, Noori and Foliente by SciPy, from reversal to reversal, in scaled numbers."""
    yields = p["strength"] / p["kappa"]

    def rates(x, state, way):
        z, energy = state
        nu, eta = 1 + p["delta_nu"] * energy, 1 + p["delta_eta"] * energy
        pinched = p["zeta_s"] * (1 - np.exp(-p["p"] * energy))
        width = (p["psi"] + p["delta_psi"] * energy) * (p["lambda"] + pinched)
        ultimate = nu ** (-1 / p["n"])
        h = 1 - pinched * np.exp(-((z / yields * way - p["q"] * ultimate) ** 2) / width**2)
        slope = h / eta * (1 - nu * abs(z / yields) ** p["n"] * (p["b"] * np.sign(z * way) + 1 - p["b"]))
        return [slope, p["kappa"] * z]

    force, state = np.zeros(len(u)), np.zeros(2)
    for k in range(1, len(u)):
        way = np.sign(u[k] - u[k - 1])
        state = solve_ivp(rates, (u[k - 1], u[k]), state, args=(way,), rtol=1e-8, atol=1e-10).y[:, -1]
        force[k] = p["rho"] * u[k] + p["kappa"] * state[0]
    return force


def test_the_degrading_law_is_that_of_an_independent_integration():
    u = np.sin(np.linspace(0, 6 * np.pi, 600)) * np.linspace(0.3, 1.0, 600)
    u /= np.abs(u).max()
    exact = integrated(u, DEGRADING)
    (force,) = hysteresis.simulated(DEGRADING, [trial(np.ones(600), u, np.zeros(600, bool))])
    assert np.sqrt(np.mean((force - exact) ** 2) / np.mean(exact**2)) < 5e-3


def test_the_plain_law_is_found_again():
    u = growing()
    exact = 3e4 * integrated(u / 0.02, {**DEGRADING, **hysteresis.PLAIN, "psi": 1.0, "lambda": 1.0})
    test = trial(exact)
    forces = METHODS["plain law"]([test])
    assert records.error([test], forces, "held") < 0.02


@pytest.mark.whole
@pytest.mark.parametrize("name", METHODS)
def test_no_method_sees_the_force_that_it_predicts(name):
    u = growing(120)
    force = 1e6 * u + 2e3 * np.sign(np.gradient(u))
    honest = trial(force, u)
    other = trial(np.where(honest.held, 7e4, force), u)
    first, second = METHODS[name]([honest]), METHODS[name]([other])
    assert np.array_equal(first[0], second[0])
    assert records.error([honest], first, "fitted") < 0.35


def test_an_error_is_over_the_measured_force_and_not_about_its_mean():
    test = trial(np.full(240, 5.0))
    assert records.error([test], [np.zeros(240)], "held") == 1.0
    assert records.error([test], [np.full(240, 6.0)], "held") == pytest.approx(0.2)


def campaign(rows=240, cycles=6):
    """A record of which the first two thirds are fitted."""
    u = growing(rows, cycles)
    record = hx.Record(np.arange(rows, dtype=float), {"elongation": u, "force": 1e6 * u})
    channels = {name: hx.measurements.Channel(name, unit) for name, unit in (("elongation", "m"), ("force", "N"))}
    begin = 2 * rows // 3
    fitted = hx.Experiment("wall", record=record, window=(0.0, begin - 1.0))
    held = hx.Experiment("wall_end", record=record, split="test", window=(float(begin), rows - 1.0))
    return hx.Campaign("wall", "displacement", channels=channels, experiments=(fitted, held))


def test_the_last_rows_are_the_window_that_the_package_holds_out():
    (test,) = records.tests_of(campaign(), "last rows")
    assert np.flatnonzero(test.held).tolist() == list(range(160, 240))
    assert np.array_equal(test.fitted, ~test.held)


def test_every_third_cycle_is_that_of_the_phase():
    (test,) = records.tests_of(campaign(), "every third cycle")
    number = np.floor(np.linspace(0, 6, 240)).astype(int)
    expected = number % 3 == 2
    expected[-1] = True  # the last row ends the sixth cycle
    # A row at a crossing of zero may count to either cycle.
    assert np.count_nonzero(test.held != expected) <= 4
    assert np.array_equal(test.fitted, ~test.held)


def test_the_program_fits_the_same_rows_as_the_other_methods():
    whole = campaign()
    (test,) = records.tests_of(whole, "every third cycle")
    masks = {"train": np.zeros(240, bool), "test": np.zeros(240, bool)}
    parts = records.windowed(whole)
    for part in parts:
        masks[part.split] |= part.in_window
    assert np.array_equal(masks["train"], test.fitted) and np.array_equal(masks["test"], test.held)
    assert len(parts) == 4 and len({part.id for part in parts}) == 4


def test_a_long_record_without_time_has_windows_of_its_rows(tmp_path):
    parts = records.windowed(campaign(9000))
    hx.write_campaign(parts, tmp_path / "campaign")
    (first, *_), rows = parts.experiments, sum(int(part.in_window.sum()) for part in parts)
    assert np.array_equal(first.record.time, np.arange(len(first.record)))
    assert rows == len(first.record) < 4000


def test_a_window_with_few_samples_is_left_out():
    # Cycles of eleven samples each, of which the third one is judged, and half a cycle at the end.
    whole = campaign(60, 5.5)
    counts = [int(part.in_window.sum()) for part in records.windowed(whole)]
    assert min(counts) >= 8 and sum(counts) < 60


def test_two_cycles_leave_nothing_to_judge():
    with pytest.raises(hx.UserError, match="leaves no row that is held"):
        records.tests_of(campaign(240, 2), "every third cycle")


def test_a_long_record_is_thinned_and_keeps_its_split():
    long = campaign(9000)
    for question in records.QUESTIONS:
        (test,) = records.tests_of(long, question)
        assert len(test.force) <= 1.2 * records.MOST_ROWS
        assert 0.25 < test.held.mean() < 0.45
        assert not (test.held & test.fitted).any()


def row(case, held, own=None):
    found = {name: {"fitted": 0.0, "held": value, "seconds": 1.0} for name, value in zip(METHODS, held, strict=True)}
    return {
        "case": case,
        "set": "s",
        "comparisons": {"last rows": found},
        **({"own": {"last rows": own}} if own else {}),
    }


OWN = {"plain": 0.9, "named": 0.05, "noise": 0.01, "verdict": "missing_effects", "effects": ["slip"], "forms": {}, "seconds": 60,
       "behaviour": "strength falls", "ended": "2026-11-26T12:00", "loop": [[0.0], [0.0]]}  # fmt: skip


def rows_of(*remainders):
    """Three records, whose runs have such errors with the remainder; None: they ran before it was learned."""
    held = ((0.8, 0.2, 0.3, 2.0), (0.6, 0.4, 0.1, 1.5), (0.7, 0.3, 0.2, 0.5))
    runs = [
        {**OWN, "named": named} | ({} if remainder is None else {"remainder": remainder})
        for named, remainder in zip((0.05, 0.5, 0.6), remainders, strict=True)
    ]
    return [row(*one) for one in zip("abc", held, runs, strict=True)]


def test_the_summary_counts_what_its_rows_hold():
    found = table.summary(rows_of(None, None, None), "last rows")
    lines = {line.split(" | ")[0].removeprefix("| "): line for line in found.splitlines()}
    assert lines["with what is named, hsed_jax"].startswith("| with what is named, hsed_jax | 3 | **0.500** |")
    assert lines["Bouc-Wen-Baber-Noori"] == "| Bouc-Wen-Baber-Noori | 3 | **0.300** | 0.250 to 0.350 | 0 | 0 | 1.0 |"
    assert lines["Gaussian process"] == "| Gaussian process | 3 | **0.200** | 0.150 to 0.250 | 2 | 0 | 1.0 |"
    assert lines["recurrent network"].split(" | ")[5] == "2"


def test_runs_without_a_remainder_are_not_compared_with_those_that_have_one():
    told = table.markdown(rows_of(0.04, None, 0.1))
    everywhere, learned = told.split("\n\nLast rows, ")
    assert "3 records" in everywhere and "with the remainder" not in everywhere
    assert learned.startswith("the 2 of these records that were run since the remainder is learned")
    assert "| with the remainder, hsed_jax | 2 | **0.070** | 0.055 to 0.085 | 2 | 0 | – |" in learned
    assert "with the remainder, hsed_jax | 3 |" in table.markdown(rows_of(0.04, 0.1, 0.1))


def test_a_refused_record_is_listed_with_its_reason():
    rows = [{"case": "w1", "set": "s", "refused": "w1: w1, elongation: one loading branch: no hysteresis. More."}]
    assert table.refusals(rows) == {"RECORD, elongation: one loading branch: no hysteresis": ["w1"]}
    assert "one loading branch: no hysteresis (1): w1." in text([*rows, row("a", (0.8, 0.2, 0.3, 2.0), OWN)])


def test_results_are_kept_by_record_and_resumed(tmp_path, monkeypatch):
    asked = []

    def compared(one, known):
        asked.append((one.name, known))
        return {"last rows": {}}

    monkeypatch.setattr(published, "compared", compared)
    monkeypatch.setattr(published, "own_run", lambda *_: {"failed": "no end after 5 s"})
    ones = [records.Specimen(tmp_path / f"{name}.csv", "s") for name in "ab"]
    output = tmp_path / "board.jsonl"
    published.measure(ones[:1], output, ["comparisons"], records.QUESTIONS, False, (), None)
    published.measure(ones, output, published.PARTS, records.QUESTIONS[:1], True, (), None)
    assert [name for name, _ in asked] == ["a", "a", "b"]
    assert [row["own"] for row in published.read(output)] == [{"last rows": {"failed": "no end after 5 s"}}] * 2
    published.measure(ones, output, published.PARTS, records.QUESTIONS[:1], True, (), None)
    assert len(asked) == 3
    published.measure(ones, output, ["own"], records.QUESTIONS, True, (), None)
    assert len(asked) == 3 and [list(row["own"]) for row in published.read(output)] == [[*records.QUESTIONS]] * 2


def test_the_page_is_that_of_the_results():
    rows = published.read(published.RESULTS)
    assert (ROOT / "docs" / "board.md").read_text(encoding="utf-8") == text(rows)
    assert len({row["case"] for row in rows}) == len(rows)
    assert json.dumps(rows)  # numbers of the page are numbers: NaN would not be read back
    assert "NaN" not in published.RESULTS.read_text(encoding="utf-8")
