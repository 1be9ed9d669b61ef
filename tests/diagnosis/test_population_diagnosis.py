"""Which specimens have an effect: all of them, one of six, or none, with its number accounted for."""

from dataclasses import replace

import numpy as np
import pytest
from builders.springs import NOISE, C, spring_campaign, spring_study

from hsed_jax.analysis.calibration import calibrate_built
from hsed_jax.analysis.specimens import over_specimens
from hsed_jax.diagnosis.candidates import problem_of
from hsed_jax.diagnosis.diagnose import diagnose
from hsed_jax.diagnosis.specimens import weigh_explanations
from hsed_jax.measurements import Campaign, Record
from hsed_jax.study.build import Built

STRENGTHS = (1.0, 1.08, 0.93, 1.02, 0.97, 1.1)
FEW = ["viscous_damping", "hardening", "slip"]


def specimens(having) -> Campaign:
    """Six specimens, each of its own strength and tested in two ways, with a dashpot in some of them."""
    plain, damped, found = spring_campaign(0.0, noise=1e-9), spring_campaign(C, noise=1e-9), []
    for number, strength in enumerate(STRENGTHS):
        for e, with_it in list(zip(plain, damped, strict=True))[:2]:
            force = strength * e.record["force"]
            if number in having:
                force = force + with_it.record["force"] - e.record["force"]
            force = force + NOISE * np.random.default_rng([7, number, len(found)]).standard_normal(len(force))
            record = Record(e.record.time, {"elongation": e.record["elongation"], "force": force})
            found.append(replace(e, id=f"S{number}_{e.id}", record=record, metadata={"specimen": f"S{number}"}))
    return replace(plain, experiments=tuple(found), channels=spring_campaign(0.0).channels)


def judged(having):
    campaign = specimens(having)
    study = spring_study()
    model = study.model.model_copy(update={"levels": {"specimen": {"A": {}}}})
    built = Built(study.model_copy(update={"model": model}), campaign)
    small = built.study.calibration.model_copy(update={"sampler": "laplace", "starts": 1})
    built = Built(built.study.model_copy(update={"calibration": small}), campaign)
    calibration = calibrate_built(built, campaign)

    def problem_with(some):
        return problem_of(built, some, FEW).calibrated(calibration.map, calibration.apart(some))

    problem = problem_with(campaign)
    found = diagnose(problem)
    return over_specimens(found, problem, problem_with, built, campaign, lambda line: None), calibration


@pytest.mark.whole
@pytest.mark.parametrize(("having", "verdict"), [(range(6), "population"), ((2,), "specimens")])
def test_an_effect_is_said_to_be_of_those_that_have_it(having, verdict):
    found, calibration = judged(having)
    strengths = np.asarray([v["mean"] for v in calibration.fit.levels()["specimen"]["A"]["of"].values()])
    has = np.isin(np.arange(6), list(having))
    # A dashpot that only one has is strength to a model without it.
    alike = (strengths / STRENGTHS)[has if has.all() else ~has]
    np.testing.assert_allclose(alike / alike.mean(), 1.0, rtol=0.05)
    (one,) = found.specimens
    assert (one.effect, one.level, one.verdict) == ("viscous_damping", "specimen", verdict)
    assert list(one.members) == [f"S{number}" for number in having] and one.probability > 0.9
    sizes = np.asarray([v["mean"] for v in one.of.values()])
    assert sizes[has].min() > 5 * np.abs(sizes[~has]).max(initial=0.0)
    assert sizes[has] == pytest.approx(sizes[has].mean(), rel=0.15)
    assert one.sentence in str(found) and found.summary()["specimens"][0]["members"] == list(one.members)
    if verdict == "specimens":
        assert "is of specimen S2 only, 1 of 6" in one.sentence


@pytest.mark.whole
def test_nothing_is_judged_where_nothing_is_missing():
    found, _ = judged(())
    assert found.verdict == "adequate" and not found.specimens and "specimens" not in found.summary()


def likelihoods(sizes, sd, at):
    return np.stack([-0.5 * ((at - size) / sd) ** 2 for size in sizes])


@pytest.mark.parametrize("is_signed", [True, False])
@pytest.mark.parametrize(
    ("sizes", "verdict", "having"),
    [
        ([1.0, 0.9, 1.1, 0.8, 1.0, 1.05], "population", range(6)),
        ([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], "specimens", [0]),
        ([0.0, 0.0, 0.9, 0.0, 1.0, 0.0], "specimens", [2, 4]),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "scatter", []),
    ],
)
def test_three_explanations_are_told_apart_by_sizes_that_are_known(is_signed, sizes, verdict, having):
    at = np.linspace(-1.0 if is_signed else 0.0, 1.6, 1600)
    found = weigh_explanations(at, likelihoods(sizes, 0.05, at), -0.5 * (at / 2) ** 2)
    assert found.verdict == verdict and found.probability > 0.9
    assert found.named([str(m) for m in range(6)]) == [str(m) for m in having]


def test_sizes_of_both_signs_are_scatter():
    at = np.linspace(-1.0, 1.6, 1600)
    found = weigh_explanations(at, likelihoods([0.5, -0.4, 0.3, -0.7, 0.1, -0.2], 0.1, at), -0.5 * (at / 2) ** 2)
    assert found.verdict == "scatter" and found.probability > 0.9


def test_of_many_that_have_nothing_few_look_odd():
    at, random = np.linspace(-1.0, 1.6, 1600), np.random.default_rng(3)
    verdicts = []
    for _ in range(40):
        sizes = 0.1 * random.standard_normal(10)
        found = weigh_explanations(at, likelihoods(sizes, 0.1, at), -0.5 * (at / 2) ** 2)
        verdicts.append(found.verdict)
    # One in ten looks odd at 5 % in two of three campaigns.
    assert verdicts.count("scatter") >= 38
