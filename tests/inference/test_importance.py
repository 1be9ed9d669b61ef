"""Importance sampling on densities whose evidence and moments are known, and where it has to say that it missed a part."""

import numpy as np
import pytest
from scipy import stats

from hsed_jax.inference.importance import Proposal, resampled, weigh, weighted

SEEDS = range(20)


def proposal_of(size, width=1.0):
    return Proposal(np.zeros(size), width * np.eye(size))


@pytest.mark.verification("inference")
def test_evidence_and_moments_of_a_skewed_density_are_the_exact_ones(observed):
    # Logarithms of gamma variates: skewed, their moments known.
    shape = np.asarray([0.7, 2.0, 5.0])
    target = lambda x: np.sum(shape * x - np.exp(np.minimum(x, 50.0)), axis=1)  # noqa: E731
    from scipy.special import digamma, gammaln, polygamma

    found = [weigh(target, proposal_of(3), 2000, np.random.default_rng(seed)) for seed in SEEDS]
    assert all(one.reliable for one in found)
    means = np.asarray([one.weights @ one.points for one in found])
    errors = np.asarray([np.sqrt(one.weights**2 @ (one.points - digamma(shape)) ** 2) for one in found])
    off = (means - digamma(shape)) / errors
    # A twentieth of a standard deviation is what adapting may cost; the errors are the stated ones.
    biases = (np.mean(means, axis=0) - digamma(shape)) / np.sqrt(polygamma(1, shape))
    observed("means of log-gamma variates by importance sampling, in standard deviations", "digamma", biases, 0.05)
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.5
    evidence = np.asarray([one.log_evidence for one in found])
    off = np.sqrt(min(one.worth for one in found)) * (evidence - np.sum(gammaln(shape)))
    observed("log evidence of log-gamma variates, in standard errors", "log gamma", off, 4.0)


def test_a_bad_first_proposal_is_learned_from_and_counts_for_little():
    target = lambda x: np.sum(stats.norm.logpdf(x, [3.0, -2.0], [0.1, 5.0]), axis=1)  # noqa: E731
    found = weigh(target, proposal_of(2), 2000, np.random.default_rng(0))
    assert found.reliable and found.worth > 500
    assert abs(found.log_evidence) < 0.2


def test_draws_that_miss_a_long_tail_are_seen():
    """Half of the density lies along an arm that reaches ten times as far as the other half, which the proposal is as wide as."""
    size = 12
    narrow, arm = np.ones(size), np.r_[10.0, np.ones(size - 1)]

    def target(x):
        one = np.sum(stats.norm.logpdf(x, 0.0, narrow), axis=1)
        other = np.sum(stats.norm.logpdf(x, 0.0, arm), axis=1)
        return np.logaddexp(one, other) - np.log(2)

    exact, found = np.sqrt(0.5 * (1 + 10.0**2)), []
    for seed in SEEDS:
        one = weigh(target, proposal_of(size), 2000, np.random.default_rng(seed))
        found.append(one.reliable)
        width = np.sqrt(one.weights @ one.points[:, 0] ** 2)
        # Either it has found the arm, or it does not vouch for what it found.
        assert not one.reliable or abs(width / exact - 1) < 0.15
    # Steps that see the arm teach where it is.
    assert np.mean(found) > 0.5


def test_draws_of_a_gaussian_are_vouched_for():
    target = lambda x: np.sum(stats.norm.logpdf(x), axis=1)  # noqa: E731
    found = [weigh(target, proposal_of(10), 2000, np.random.default_rng(seed)) for seed in SEEDS]
    assert all(one.reliable and one.doubt is None for one in found)


def test_if_one_draw_has_all_the_weight_flattened_weights_leave_a_width():
    """In 25 dimensions, each three times as narrow as the proposal, a few of 2000 draws have nearly all the weight."""
    size = 25
    target = lambda x: np.sum(stats.norm.logpdf(x, 0.0, 1 / 3), axis=1)  # noqa: E731
    random = np.random.default_rng(0)
    points = proposal_of(size).draw(random, 2000)
    found = weighted(points, target(points), target(points) - proposal_of(size).log_density(points))
    assert found.worth < 5 and found.doubt is not None
    width = np.sqrt(found.flattened().weights @ points**2).mean()
    # Wider than the density, narrower than the proposal, whose standard deviation is the root of 5/3.
    assert 1 / 3 < width < np.sqrt(5 / 3)
    chosen = resampled(found.flattened(), 2000, random)[0]
    assert len(np.unique(chosen[:, 0])) > 4 * size


def test_reliable_weights_are_not_flattened():
    found = weigh(lambda x: np.sum(stats.norm.logpdf(x), axis=1), proposal_of(3, 1.2), 2000, np.random.default_rng(0))
    assert found.reliable
    np.testing.assert_allclose(found.flattened().weights, found.weights, rtol=1e-12)
