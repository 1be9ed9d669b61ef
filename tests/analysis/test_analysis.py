"""The Python sentence: what a notebook calls."""

import numpy as np
import pytest

import hsed_jax as hx


@pytest.fixture(scope="module")
def study():
    return hx.load_study("configs/paper.yaml")


def test_simulate_is_the_independent_reference(study):
    # peers' DOP853 with events at the kinks, eta = 0: 1.2548068e5 N, 0.2538289 m; the study's own step is good to 1e-4
    response = hx.simulate(study, {"V_P": 2.25, "T_P": 1.0}, {"A": 5e5, "beta": 1.0})
    assert float(response.quantities["peak_force"]) == pytest.approx(1.2548068e5, rel=1e-4)
    assert float(response.quantities["peak_elongation"]) == pytest.approx(0.2538289, rel=1e-4)
    assert np.abs(response.channels["force"]).max() == pytest.approx(1.2548068e5, rel=5e-3)


def test_a_batch_is_its_members(study):
    periods = np.array([0.6, 1.0, 1.4])
    batch = hx.simulate(study, {"V_P": 2.25, "T_P": periods}, channels=())
    alone = [hx.simulate(study, {"V_P": 2.25, "T_P": float(T)}, channels=()) for T in periods]
    for name, values in batch.quantities.items():
        # the same arithmetic in another order: differences of 1e-15 were measured
        np.testing.assert_allclose(values, [float(r.quantities[name]) for r in alone], rtol=1e-12)


def test_a_large_batch_goes_in_parts_and_comes_back_in_order(study):
    periods = np.linspace(0.5, 1.5, 5000)
    batch = hx.simulate(study, {"V_P": 2.25, "T_P": periods}, channels=())
    assert batch.ok.shape == (5000,) and bool(batch.ok.all())
    some = [0, 2047, 2048, 4095, 4096, 4999]
    few = hx.simulate(study, {"V_P": 2.25, "T_P": periods[some]}, channels=())
    for name, values in batch.quantities.items():
        np.testing.assert_allclose(values[np.asarray(some)], few.quantities[name], rtol=1e-12)


@pytest.mark.parametrize(
    ("inputs", "parameters", "message"),
    [
        ({"V_P": 2.0}, {}, "input 'T_P' is missing"),
        ({"V_P": 2.0, "T_P": 1.0, "PGA": 1.0}, {}, "no input 'PGA'"),
        ({"V_P": 2.0, "T_P": 1.0}, {"eta": 1.0}, "no parameter 'eta'"),
        ({"V_P": np.ones(2), "T_P": np.ones(3)}, {}, "arrays of one common length"),
        ({"V_P": 2.0, "T_P": np.ones(0)}, {}, "nothing to simulate"),
    ],
)
def test_what_does_not_fit_the_study_is_refused(study, inputs, parameters, message):
    with pytest.raises(hx.UserError, match=message):
        hx.simulate(study, inputs, parameters)
