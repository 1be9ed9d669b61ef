"""The worth of earlier experiments: of a straight line that of the textbook, of the paper's frame that of a calibration."""

import numpy as np
import pytest
import yaml

import hsed_jax as hx
from hsed_jax.analysis.prior_worth import PLANNED, worth_of
from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, write_campaign
from hsed_jax.study.build import Built

FUNCTION = """
def line(parameters, inputs):
    return {"peak_force": parameters["a"] * inputs["x"] + parameters["b"]}


def perform(inputs):
    return {"peak_force": 1.0}
"""
SIGMA, PRIORS, X = 0.3, (2.0, 5.0), (1.0, 1.2, 5.0)


def campaign_at(xs, sigma=SIGMA, **changes):
    quantities = {"peak_force": Channel("peak_force", "N", noise=Noise(absolute=sigma))}
    experiments = tuple(Experiment(f"E{k}", {"x": x}, quantities={"peak_force": 1.0}) for k, x in enumerate(xs))
    return Campaign("line", "ground_motion", {"x": "1"}, {}, quantities, experiments, **changes)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("line")
    (folder / "mine.py").write_text(FUNCTION, encoding="utf-8")
    prior = {name: {"normal": [0.0, sd], "unit": "N"} for name, sd in zip("ab", PRIORS, strict=True)}
    content = {
        "study": "line",
        "inputs": {"x": {"uniform": [1.0, 5.0]}},
        "model": {"function": "mine.py:line", "parameters": prior},
        "excitation": {"near_fault_pulse": {"V_P": 1.0, "T_P": 1.0, "gamma": 2.0, "nu": 0.1}, "duration": 2.0},
        "experiments": {"python": {"file": "mine.py", "function": "perform"}},
        "quantities": ["peak_force"],
        "error": {"absolute": SIGMA},
        "design": {"initial": 3, "iterations": 2},
    }
    (folder / "study.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return load_study(folder / "study.yaml")


def removed(xs, planned):
    """The share that measurements at xs remove of the variance of a line at the planned places, by Bayes' theorem."""
    design = np.stack([np.asarray(xs), np.ones(len(xs))], axis=1).reshape(-1, 2)
    prior = np.diag(np.square(PRIORS))
    posterior = np.linalg.inv(np.linalg.inv(prior) + design.T @ design / SIGMA**2)
    g = np.stack([planned, np.ones_like(planned)], axis=1)
    return 1 - np.einsum("mp,pq,mq->", g, posterior, g) / np.einsum("mp,pq,mq->", g, prior, g)


@pytest.mark.whole
def test_of_a_straight_line_it_is_that_of_the_textbook(study):
    built = Built(study)
    found = worth_of(built.inference, campaign_at(X))
    space = built.experiments.space
    planned = space.si(space.declared(space.spread(PLANNED)))["x"]
    assert planned.min() < 1.2 and planned.max() > 4.8
    assert found.together == pytest.approx(removed(X, planned), rel=1e-5)
    np.testing.assert_allclose(found.alone, [removed([x], planned) for x in X], rtol=1e-5)
    lost = [removed(X, planned) - removed([o for o in X if o != x], planned) for x in X]
    np.testing.assert_allclose(found.lost, lost, rtol=1e-3)
    # Two of them are nearly the same, so that neither is missed; the third is.
    assert found.lost[2] > 5 * max(found.lost[:2])


@pytest.mark.whole
def test_check_says_it_in_a_sentence_and_a_table(study, tmp_path, capsys):
    write_campaign(campaign_at(X), tmp_path / "old")
    assert main(["check", study.file, "--trust", "--worth", str(tmp_path / "old")]) == 0
    said = capsys.readouterr().out
    assert "3 earlier experiments remove" in said and "lost without it" in said


def test_what_cannot_be_compared_is_refused(study, tmp_path):
    built = Built(study)
    other = Campaign("line", "ground_motion", {"V": "m/s"}, {}, campaign_at(X).quantities)
    with pytest.raises(UserError, match="no completed training experiment"):
        worth_of(built.inference, other)
    other = other.add(Experiment("E0", {"V": 1.0}, quantities={"peak_force": 1.0}))
    with pytest.raises(UserError, match="it has the inputs V; the study has x"):
        worth_of(built.inference, other)


@pytest.mark.whole
def test_of_the_papers_frame_it_is_what_a_calibration_leaves():
    study = hx.load_study(
        "configs/paper.yaml",
        ["model.parameters={A: {normal: [5.0e5, 2.0e4]}, beta: {normal: [1.0, 0.05]}, gamma: 0.0, n: 1.0}"],
    )
    built = Built(study)
    campaign = built.site.perform()
    found = worth_of(built.inference, campaign)
    # The posterior by importance sampling, and simulations of the planned experiments at its draws and at those of the prior.
    fit = hx.calibrate(
        study.model_copy(update={"calibration": study.calibration.model_copy(update={"sampler": "importance"})}),
        campaign,
    )
    space = built.experiments.space
    inputs = space.si(space.declared(space.spread(8)))
    draws = {name: np.asarray(fit.posterior["posterior"][name]).ravel()[:200] for name in ("A", "beta")}
    random = np.random.default_rng(0)
    prior = {"A": 5e5 + 2e4 * random.standard_normal(200), "beta": 1.0 + 0.05 * random.standard_normal(200)}

    def variance(parameters):
        response = [
            hx.simulate(study, {k: float(v[i]) for k, v in inputs.items()}, parameters, channels=()) for i in range(8)
        ]
        return {q: np.mean([np.var(np.asarray(r.quantities[q])) for r in response]) for q in study.quantities}

    before, after = variance(prior), variance(draws)
    for name, share in found.by_output.items():
        assert 1 - share == pytest.approx(after[name] / before[name], rel=0.4), name
