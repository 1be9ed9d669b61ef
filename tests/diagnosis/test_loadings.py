"""The loading that separates explanations: what it may ask of a specimen, and that it separates two that one test does not."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from builders.diagnoses import candidate, diagnosis
from builders.springs import spring_study

import hsed_jax as hx
from hsed_jax.behaviour.histories import Range
from hsed_jax.command_line import main
from hsed_jax.diagnosis.candidates import problem_of
from hsed_jax.diagnosis.diagnose import _started
from hsed_jax.diagnosis.loadings import _sequences, next_loading
from hsed_jax.diagnosis.probing import Probe
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, Record, write_campaign
from hsed_jax.plain import dump_yaml
from hsed_jax.runs.proposed_loading import FILE, ask_loading, history
from hsed_jax.study.build import Built

STIFFNESS, YIELD, NOISE = 2.0e7, 5e-3, 3e3
PAIR = ("strength_degradation", "peak_softening")


def softening(turns, of_energy: float, of_peak: float, each: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """Elongation and force of a rounded elastoplastic spring whose strength falls with energy or with the largest elongation."""
    u = np.concatenate([np.linspace(a, b, each, endpoint=False) for a, b in pairwise(turns)])
    force, z, energy, largest = np.zeros(u.size), 0.0, 0.0, 0.0
    for k in range(1, u.size):
        step = (u[k] - u[k - 1]) / 10
        for part in np.linspace(u[k - 1], u[k], 11)[1:]:
            z += (STIFFNESS * (1 - abs(z) * np.sign(step * z) / (STIFFNESS * YIELD))) * step
            energy, largest = energy + abs(z * step), max(largest, abs(part))
        force[k] = z * np.exp(-of_energy * energy / (STIFFNESS * YIELD**2) - of_peak * largest / YIELD)
    return u, force


def growing(cycles: int = 8) -> np.ndarray:
    """Each amplitude once: energy and largest elongation grow together."""
    return np.concatenate([[0.0], *([a, -a] for a in 4 * YIELD * np.arange(1, cycles + 1) / cycles), [0.0]])


def campaign_of(*records: tuple[np.ndarray, np.ndarray]) -> Campaign:
    random = np.random.default_rng(0)
    experiments = [
        Experiment(
            f"E{k}",
            record=Record(np.arange(u.size), {"elongation": u, "force": f + NOISE * random.normal(size=u.size)}),
        )
        for k, (u, f) in enumerate(records)
    ]
    channels = {"elongation": Channel("elongation", "m"), "force": Channel("force", "N", noise=Noise(absolute=NOISE))}
    return Campaign("loadings", "displacement", {}, channels, {}, tuple(experiments))


def searched(campaign: Campaign):
    problem = problem_of(Built(spring_study(), campaign), campaign, effects=list(PAIR))
    search = _started(problem, lambda line: None)
    search.run()
    return problem, search, [search.model({effect}) for effect in PAIR]


@pytest.fixture(scope="module")
def once():
    return searched(campaign_of(softening(growing(), 0.01, 0.0)))


@pytest.mark.parametrize("has_time", [False, True])
def test_no_candidate_needs_more_stroke_or_path_than_the_test(has_time):
    visited = Range(growing(), 0.01, has_time)
    found = [*_sequences(visited)]
    assert len({name for name, *_ in found}) == len(found) and found[0][0] == "the same test again"
    for name, turns, rate in found:
        assert turns[0] == 0 and len(turns) > 2, name
        assert np.abs(turns).max() <= visited.elongation * (1 + 1e-12), name
        assert np.abs(np.diff(turns)).sum() <= visited.path * (1 + 1e-6), name
        assert rate == pytest.approx(0.001 if "slower" in name else 0.01)
    assert {rate for *_, rate in found} == ({0.01, 0.001} if has_time else {0.01})


@pytest.mark.whole
def test_a_loading_separates_what_one_growing_test_does_not(once):
    problem, search, models = once
    assert problem.simulator is not None and problem.visited is not None
    loading = next_loading(Probe(problem, problem.simulator, problem.visited), search, models)
    assert loading is not None and loading.expected_log_bayes_factor > 2 * loading.repeated
    assert loading.name in loading.sentence and loading.summary()["unit"] == "m"
    # Both specimens do the loading; the misfit of each model to the other's test after a fit is what the loading can show.
    apart = []
    for turns in (growing(), np.concatenate([[0.0], loading.reversals])):
        tests = [softening(turns, *amounts) for amounts in ((0.01, 0.0), (0.0, _alike()))]
        apart.append(np.sqrt(np.mean((tests[0][1] - tests[1][1]) ** 2) / np.mean(tests[0][1] ** 2)))
    assert apart[1] > 1.5 * apart[0]


def _alike() -> float:
    """The loss with the largest elongation that does in the growing test what energy does."""
    goal = softening(growing(), 0.01, 0.0)[1]
    return min(np.linspace(0.0, 0.5, 51), key=lambda x: np.mean((softening(growing(), 0.0, x)[1] - goal) ** 2))


@pytest.mark.whole
def test_without_a_measured_force_no_loading_is_proposed(once):
    problem, search, models = once
    without = problem._replace(outputs=("dissipated_energy",))
    assert next_loading(Probe(without, problem.simulator, problem.visited), search, models) is None


@pytest.mark.whole
def test_the_loading_is_in_the_summary_and_among_the_notes(once):
    problem, search, models = once
    loading = next_loading(Probe(problem, problem.simulator, problem.visited), search, models)
    without = diagnosis([candidate("pinching", 1.0)])
    found = replace(without, next_loading=loading)
    assert found.summary()["next_loading"] == loading.summary() and loading.sentence in found.summary()["notes"]
    assert "next_loading" not in without.summary()


def test_a_command_passes_the_reversals_at_the_rate():
    reversals = [0.0, 0.02, -0.02, 0.01, -0.01]
    time, elongation = history(reversals, 0.005)
    assert time is not None
    np.testing.assert_allclose(np.abs(np.diff(elongation) / np.diff(time)), 0.005)
    turns = [0, *(np.flatnonzero(np.diff(np.sign(np.diff(elongation)))) + 1), len(elongation) - 1]
    np.testing.assert_allclose(elongation[turns], reversals, atol=1e-15)
    assert history(reversals, None)[0] is None


@pytest.mark.parametrize("rate", [None, 0.005])
def test_a_laboratory_gets_a_file_that_it_returns_with_its_force(tmp_path, rate):
    whole = campaign_of(softening(growing(), 0.01, 0.0))
    in_mm = replace(whole, channels={**whole.channels, "elongation": Channel("elongation", "mm")})
    write_campaign(in_mm, tmp_path / "campaign")
    loading = {
        "name": "cycles",
        "reversals": [0.02, -0.02, 0.01],
        "rate": rate,
        "expected_log_bayes_factor": 9.0,
        "repeated": 2.0,
    }
    found = {"study": "wall", "status": "complete", "diagnosis": {"next_loading": loading}}
    (tmp_path / "summary.json").write_text(json.dumps(found), encoding="utf-8")
    said = ask_loading(tmp_path)
    assert "at most 20 mm" in said and ("18 s" in said) == (rate is not None)
    command, file = (tmp_path / FILE).read_text(encoding="utf-8").splitlines(), tmp_path / "wall_2.csv"
    file.write_text("\n".join([f"{command[0]},force [kN]", *(f"{line},1.0" for line in command[1:])]), encoding="utf-8")
    record = hx.read_files(file)["wall_2"].record
    assert record is not None
    np.testing.assert_allclose(record["elongation"], history([0.0, *loading["reversals"]], rate)[1], atol=1e-8)


def test_a_diagnosis_that_proposes_no_loading_has_none_to_ask_for(tmp_path, capsys):
    (tmp_path / "study.yaml").write_text(dump_yaml(spring_study().written()), encoding="utf-8")
    (tmp_path / "summary.json").write_text('{"study": "wall", "status": "complete", "diagnosis": {}}', encoding="utf-8")
    assert main(["ask", str(tmp_path)]) == 2
    assert "its diagnosis proposes no loading" in capsys.readouterr().err
