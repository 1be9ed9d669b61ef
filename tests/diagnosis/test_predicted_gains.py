"""Predicted gains of candidates before they are fitted, where the answer is known in closed form."""

import numpy as np
import pytest
from builders.dictionary import EFFECTS, FUNCTIONS, SIGMA, Dictionary, J, K, N, data_of, search_of

from hsed_jax.diagnosis.problem import FormColumns
from hsed_jax.diagnosis.propose import beside, predicted_gains_of
from hsed_jax.diagnosis.scores import telling
from hsed_jax.physics.effects.base import Form


class Absorbing(Dictionary):
    """The first effect is the first function of the law, and a little of its own; their sum acts more than in proportion."""

    def __call__(self, thetas, experiments, samples=None):
        total = thetas[:, 0] + thetas[:, 2]
        amplitudes = np.concatenate([total[:, None], thetas[:, 1:2], 0.3 * thetas[:, 2:3], thetas[:, 3:]], axis=1)
        amplitudes[:, -1] += 5 * (total - 2.4) ** 2
        return np.einsum("lk,klj->lj", amplitudes, self.functions[:, experiments]), np.ones(len(thetas))


class Failing(Dictionary):
    """No simulation with one of the effects succeeds."""

    def __call__(self, thetas, experiments, samples=None):
        outputs, ok = super().__call__(thetas, experiments, samples)
        return outputs, ok * (thetas[:, 4] == 0)


def gains_of(search, is_explained):
    fit = search.model(()).fit
    found = predicted_gains_of(search.models, search.standard.target, fit, search.effects, is_explained)
    return {effect: forms[""][0].gain for effect, forms in found.items()}


def test_the_gain_at_a_vanishing_size_is_half_of_raos_statistic():
    search = search_of(data_of(4, effect_3=0.05))
    gains = gains_of(search, is_explained=True)
    # The prior of an amplitude is standard normal, and a small effect is far within it.
    for effect in EFFECTS:
        assert gains[effect] == pytest.approx(0.5 * search.scores[effect], rel=1e-3, abs=1e-6), effect


def test_an_effect_that_the_law_nearly_absorbs_is_proposed_first_where_the_noise_explains_the_residual():
    theta = np.zeros((1, 2 + K))
    theta[0, :3] = 1.5, -0.7, 0.9
    exact = np.concatenate([Absorbing(FUNCTIONS)(theta, np.asarray([n]))[0] for n in range(N)])
    values = exact + SIGMA * np.random.default_rng(5).standard_normal((N, J))
    search = search_of(values, batch=Absorbing)
    gains = gains_of(search, is_explained=True)
    assert (
        max(gains, key=lambda effect: gains[effect]) == "effect_0" == max(search.scores, key=search.scores.__getitem__)
    )
    assert gains["effect_0"] > 2 * gains_of(search, is_explained=False)["effect_0"]


def test_forms_with_no_more_parameters_than_the_default_one_are_proposed_too():
    search = search_of(data_of(4, effect_1=0.5))
    fixed, other, wider = (np.array(columns) for columns in ([2], [3], [4, 5]))
    forms = {
        "": FormColumns(Form(is_default=True), fixed, {}),
        "other": FormColumns(Form("other"), other, {}),
        "wider": FormColumns(Form("wider"), wider, {}),
    }
    found = predicted_gains_of(search.models, search.standard.target, search.model(()).fit, {"effect": forms})
    assert list(found["effect"]) == ["", "other"]
    assert found["effect"]["other"][0].gain > 10 * max(found["effect"][""][0].gain, 1.0)
    chosen = beside(found, frozenset(), is_best=True)
    assert list(chosen) == [frozenset({("effect", "")}), frozenset({("effect", "other")})]


def test_the_experiments_that_propose_have_half_of_the_residual_and_enough_values():
    values = data_of(0)
    values[2] += 40.0
    search = search_of(values)
    fit, target = search.model(()).fit, search.standard.target
    assert telling(target, fit).tolist() == [2]
    # Three values of each experiment, as of quantities: all six are too few.
    few = np.zeros(values.shape, dtype=bool)
    few[:, :3] = True
    search = search_of(values, used=few)
    assert telling(search.standard.target, search.model(()).fit).tolist() == list(range(N))


def test_an_effect_whose_simulations_fail_is_not_among_the_models():
    search = search_of(data_of(4, effect_3=0.5), batch=Failing)
    search._fits.fit(search.standard.target, [frozenset({(effect, "")}) for effect in ("effect_2", "effect_3")])
    assert search.model({"effect_2"}).fit.cost == np.inf
    assert [set(model.effects) for model in search.all()] == [{"effect_3"}, set()]
