"""What a verdict owes to the priors: against searches that are made anew with other priors, and against closed forms."""

import math

import numpy as np
import pytest
from builders.dictionary import COLUMNS, EFFECTS, FUNCTIONS, LAW, PRIORS, Dictionary, K, data_of, measured_of
from scipy import stats

from hsed_jax.diagnosis.box import Box
from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.fit_state import Task
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.prior_widths import WIDTHS, Stretched, _leader, _State, moved_by, prior_widths
from hsed_jax.diagnosis.score import HeldOut
from hsed_jax.diagnosis.search import Search
from hsed_jax.inference.priors import Prior

NAMED = "effect_3"
BOX = Box(PRIORS)


def searched(values, **priors):
    models = NestedModels(Dictionary(FUNCTIONS), Box(PRIORS | priors), np.zeros(2 + K))
    search = Search(models, measured_of(values), LAW, EFFECTS, lambda fit: False)
    search.start()
    search.run()
    return search


def told(search, verdict="missing_effects", otherwise="unexplained"):
    return prior_widths(search, search.all(), search.model(search.best), verdict, otherwise)


@pytest.fixture(scope="module")
def strong():
    return searched(data_of(5, **{NAMED: 0.8}))


def test_the_gain_is_that_of_a_model_with_the_other_prior(strong):
    assert strong.best == {NAMED}
    found = told(strong)
    assert [one.width for one in found] == list(WIDTHS)
    for one in found:
        # The target is kept, so that only the prior differs.
        box = Box(PRIORS | {NAMED: Prior("normal", [0.0, one.width])})
        models = strong.models.within(box)
        worths = []
        for columns in (LAW, np.append(LAW, COLUMNS[NAMED])):
            (fit,) = models.fit(strong.standard.target, [Task(models.submodel(columns), models.neutral)])
            worths.append(laplace(fit, models))
        assert one.log_evidence_gain[NAMED] == pytest.approx(worths[1] - worths[0], abs=1e-3)
        assert one.log_evidence_gain[NAMED] != pytest.approx(one.log_evidence_gain_before[NAMED], abs=0.3)


def test_a_uniform_prior_gives_limits_and_keeps_its_width():
    search = searched(data_of(5, **{NAMED: 0.8}), **{NAMED: Prior("uniform", [0.0, 1.0])})
    assert search.best == {NAMED}
    for one in told(search):
        assert one.log_evidence_gain[NAMED] == pytest.approx(one.log_evidence_gain_before[NAMED])


def test_a_strong_effect_is_named_with_any_width(strong):
    for one in told(strong):
        assert one.is_same and one.verdict == "missing_effects" and one.effects == (NAMED,)
        assert one.sentence.startswith("with priors of the effects") and "stays the same" in one.sentence


@pytest.mark.parametrize("width", WIDTHS)
def test_predictions_of_what_is_left_out_move_as_those_of_fits_with_the_other_prior(strong, width):
    fit, about = strong.model({NAMED}).fit, np.zeros(2 + K)
    plain, box = (Stretched(BOX, COLUMNS[NAMED], about, w) for w in (1.0, width))
    moved = moved_by(strong, fit, plain, box)
    models = strong.models.within(Box(PRIORS | {NAMED: Prior("normal", [0.0, width])}))
    (again,) = models.fit(strong.standard.target, [Task(models.submodel(fit.free), models.neutral)])
    exact = HeldOut(models, strong.measured, None).densities(strong.standard.target, [again])
    own = strong.held_out.densities(strong.standard.target, [fit])
    found = strong.held_out.densities(strong.standard.target, [fit], [moved])
    # The other prior changes something, and that is what is found.
    assert np.max(np.abs(exact - own)) > 1e-3
    np.testing.assert_allclose(found, exact, atol=0.05 * np.max(np.abs(exact - own)))


def test_an_effect_that_only_a_narrow_prior_supports_loses_its_verdict_with_a_wide_one(strong):
    search = strong
    weak, none = search.model({NAMED}), search.model(())
    # As if its evidence outweighed the prior of its set by one nat: a tenth of the density is more than that.
    prior = weak.log_posterior - weak.log_evidence - (none.log_posterior - none.log_evidence)
    gain = 1.0 - prior
    weak = weak._replace(log_evidence=none.log_evidence + gain, log_posterior=none.log_posterior + gain + prior)
    _, wide = prior_widths(search, [weak, none], weak, "missing_effects", "unexplained")
    # The log ratio of two normal densities at the estimate.
    size = float(weak.fit.x[COLUMNS[NAMED][0]])
    assert wide.log_evidence_gain[NAMED] == pytest.approx(gain - math.log(10) + 0.5 * size**2 * (1 - 0.01), abs=0.02)
    assert not wide.is_same and wide.verdict == "unexplained" and wide.effects == ()
    # What was left out supports the effect still, so that the model without it does not lead.
    assert wide.leader is None
    assert "caution" in wide.sentence and "10 times wider" in wide.sentence
    assert wide.summary()["verdict"] == "unexplained" and wide.summary()["width"] == 10.0


def state(search, own, other, none=(0.0, 0.0)):
    """What three explanations are worth: probability and log posterior odds of each, the last one without an effect."""
    named, rival, less = (
        search.model(effects)._replace(probability=p, log_posterior=worth)
        for effects, (p, worth) in (({NAMED}, own), ({"effect_1"}, other), ((), none))
    )
    return _State(10.0, [named, rival, less], {NAMED: 5.0}, {NAMED: 1e3}, {NAMED: 0.0})


def test_another_explanation_leads_where_it_meets_the_demands_of_a_verdict(strong):
    best = strong.model({NAMED})
    before = state(strong, (0.9, 9.0), (0.1, 5.0))

    def leader(after, does_the_same=lambda model: False):
        return _leader(best, before, after, does_the_same)

    leads = state(strong, (0.1, 4.0), (0.9, 5.0))
    assert leader(leads) == ("effect_1",)
    # What does the same is no other explanation; what led before leads by no prior.
    assert leader(leads, lambda model: model.effects == {"effect_1"}) is None
    assert _leader(best, leads, leads, lambda model: False) is None
    # Either demand alone is not enough: odds of four, and no less evidence.
    assert leader(state(strong, (0.21, 4.0), (0.79, 5.0))) is None
    assert leader(state(strong, (0.1, 6.0), (0.9, 5.0))) is None
    # That the effect has less support is no other explanation.
    assert leader(state(strong, (0.9, 9.0), (0.1, 5.0), none=(0.95, 9.5))) is None


@pytest.mark.parametrize(
    ("prior", "scipy"),
    [
        (Prior("normal", [0.0, 0.4]), lambda w: stats.norm(0, 0.4 * w)),
        (Prior("half_normal", 1.5), lambda w: stats.halfnorm(scale=1.5 * w)),
        (Prior("uniform", [0.0, 2.0]), lambda w: stats.uniform(0, 2.0 * w)),
    ],
)
@pytest.mark.parametrize("width", WIDTHS)
def test_a_stretched_density_is_that_of_the_wider_distribution(prior, scipy, width):
    plain = Box({"a": prior})
    about = plain.x(np.zeros(1))
    box = Stretched(plain, np.array([0]), about, width)
    theta = np.array([[0.05], [0.3], [0.6]])
    scale = (plain.theta(np.ones(1)) - plain.theta(np.zeros(1)))[0]
    expected = scipy(width).logpdf(theta[:, 0]) + np.log(scale)
    np.testing.assert_allclose(box.log_density(plain.x(theta), np.array([0]))[:, 0], expected, atol=2e-3)
    terms = box.terms(plain.x(theta[1]), np.array([0]))
    step = 1e-4 * np.ones(1)
    up, down = (scipy(width).logpdf(plain.theta(plain.x(theta[1]) + s))[0] for s in (step, -step))
    assert terms.slope[0] == pytest.approx((up - down) / 2e-4, abs=2e-2)


def test_a_narrow_prior_brings_its_bounds_along_and_a_wide_one_leaves_them():
    plain = Box({"a": Prior("uniform", [0.0, 3.0])})
    about = plain.x(np.zeros(1))
    narrow, wide = (Stretched(plain, np.array([0]), about, width) for width in WIDTHS)
    assert float(plain.theta(narrow.high)[0]) == pytest.approx(1.0)
    assert float(plain.theta(wide.high)[0]) == pytest.approx(3.0)
    # A limit of what is possible is none of the prior's.
    limited = Box({"a": Prior("half_normal", 1.0)}, limits={"a": (0.0, 2.0)})
    assert float(
        limited.theta(Stretched(limited, np.array([0]), limited.x(np.zeros(1)), 1 / 3).high)[0]
    ) == pytest.approx(2.0)
