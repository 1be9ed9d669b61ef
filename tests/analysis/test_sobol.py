"""Sobol' indices: against analytic ones, their intervals, and what the paper says of the pulse."""

import math

import numpy as np
import pytest
import xarray as xr
from builders.places import ROOT

import hsed_jax as hx
from hsed_jax.analysis.sensitivity import indices_of
from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior

PAPER = ROOT / "configs" / "paper.yaml"
KINDS = ("first_order", "total_order")


def ishigami(x, a=7.0, b=0.1):
    return np.stack([np.sin(x[0]) + a * np.sin(x[1]) ** 2 + b * x[2] ** 4 * np.sin(x[0]), x[0]])


def exact(a=7.0, b=0.1):
    """Variance of each part of Ishigami's function by integration: of x1, x2, and of x1 and x3 together."""
    one, two, both = (1 + b * math.pi**4 / 5) ** 2 / 2, a**2 / 8, 8 * b**2 * math.pi**8 / 225
    total = one + two + both
    first = np.array([[one, two, 0.0], [total, 0.0, 0.0]]) / total
    return {"first_order": first, "total_order": first + np.array([[both, 0.0, both], [0.0, 0.0, 0.0]]) / total}


def of_ishigami(samples, seed):
    around = {name: Prior("uniform", [-math.pi, math.pi]) for name in ("x1", "x2", "x3")}
    return indices_of(ishigami, around, ["ishigami", "x1 itself"], samples, seed)


@pytest.mark.verification("inference")
def test_indices_are_those_of_the_analytic_function(observed):
    found = of_ishigami(2048, 0)
    assert found.indices["first_order"].dims == ("quantity", "variable")
    for kind in KINDS:
        off = found.indices[kind].values - exact()[kind]
        observed(f"Sobol' indices of Ishigami's function: {kind.replace('_', ' ')}", "integrals", off, 0.04)
    assert found.simulations == 2048 * 5


@pytest.mark.whole
def test_intervals_cover_as_often_as_they_say():
    covered = []
    for seed in range(16):
        found = of_ishigami(256, seed).indices
        for kind, true in exact().items():
            covered.append((found[f"{kind}_low"][0] <= true[0]) & (true[0] <= found[f"{kind}_high"][0]))
    assert 0.8 <= np.mean(covered) <= 0.99


@pytest.mark.verification("inference")
def test_distributions_are_followed(observed):
    variables = {"wide": Prior("normal", [5.0, 2.0]), "narrow": Prior("normal", [-1.0, 1.0])}
    found = indices_of(lambda x: x[:1] + 3 * x[1:], variables, ["sum"], 2048, 1)
    # Variances 4 and 9.
    for kind in KINDS:
        off = found.indices[kind].values[0] - np.array([4 / 13, 9 / 13])
        observed(f"Sobol' indices of a sum of normals: {kind.replace('_', ' ')}", "shares of the variance", off, 0.04)


def test_the_same_seed_gives_the_same_indices():
    one, again, other = (of_ishigami(64, seed).indices for seed in (3, 3, 4))
    xr.testing.assert_identical(one, again)
    assert not one.equals(other)


def test_what_does_not_matter_is_named():
    found = of_ishigami(1024, 0)
    assert found.negligible == []
    indices = found.indices.sel(quantity=["x1 itself"])
    assert type(found)(indices, 1).negligible == ["x2", "x3"]
    assert "below 5 % for every quantity: x2, x3" in repr(type(found)(indices, 1))


def pulse(gamma, nu):
    """The paper's study with the shape of its pulse among the inputs, and the law known."""
    return [
        "excitation.near_fault_pulse={V_P: V_P, T_P: T_P, gamma: gamma, nu: nu}",
        f"inputs.gamma={{uniform: {gamma}, unit: '1'}}",
        f"inputs.nu={{uniform: {nu}, unit: rad}}",
        "model.parameters.A={uniform: [4.99e5, 5.01e5]}",
        "model.parameters.beta=1.0",
    ]


@pytest.fixture(scope="module")
def near(tmp_path_factory):
    """Indices by the command where the pulse is within a tenth of the paper's: as it was told, and as it was written."""
    folder = tmp_path_factory.mktemp("sensitivity")
    words = ["sensitivity", str(PAPER), *pulse([1.8, 2.2], [0.0, 0.2]), "--samples", "256", "--output", str(folder)]
    assert main(words) == 0
    return folder, xr.load_dataset(folder / "indices.nc", engine="h5netcdf")


@pytest.mark.whole
def test_near_its_values_the_shape_of_the_pulse_hardly_matters_as_the_paper_says(near):
    _, indices = near
    assert set(indices["variable"].values) == {"V_P", "T_P", "gamma", "nu", "A"}
    assert float(indices["total_order_high"].sel(variable=["gamma", "nu", "A"]).max()) < 0.05
    assert float(indices["total_order_low"].sel(variable=["V_P", "T_P"]).min()) > 0.1


def test_the_command_writes_the_figure(near):
    folder, indices = near
    assert (folder / "sensitivity.png").stat().st_size > 10_000
    text = (folder / "sensitivity.svg").read_text()
    assert "Index of peak force" in text and f"{float(indices['total_order'][0, 0]):.2f}" in text


def test_over_all_pulses_the_phase_hardly_matters_and_the_number_of_oscillations_does():
    found = hx.sensitivity(hx.load_study(PAPER, pulse([1.5, 4.0], [0.0, 2 * math.pi])), samples=256).indices
    assert float(found["total_order_high"].sel(variable="nu").max()) < 0.02
    energy = found.sel(quantity="dissipated_energy", variable="gamma")
    assert float(energy["total_order_low"]) > 0.1


@pytest.mark.whole
def test_an_input_and_a_parameter_of_one_name_are_told_apart():
    words = [*pulse([1.8, 2.2], [0.0, 0.2]), "model.parameters.gamma={uniform: [0.0, 0.1]}", "excitation.duration=2.0"]
    found = hx.sensitivity(hx.load_study(PAPER, words), samples=4)
    assert [str(n) for n in found.indices["variable"].values] == ["V_P", "T_P", "gamma", "nu", "A", "gamma (law)"]


@pytest.mark.parametrize(
    ("words", "samples", "message"),
    [
        ([], 100, "samples: this must be a power of two, such as 1024, but it is 100"),
        ([], 1, "samples: this must be a power of two, such as 1024, but it is 1"),
        ([], 2**40, "samples: 1099511627776 would take 4."),
        (
            ["model.parameters.gamma={uniform: [-900.0, 900.0]}", "excitation.duration=2.0"],
            8,
            "simulations diverge; narrow",
        ),
    ],
)
def test_a_mistake_is_one_sentence(capsys, words, samples, message):
    assert main(["sensitivity", str(PAPER), *words, "--samples", str(samples)]) == 2
    assert message in capsys.readouterr().err


def test_there_must_be_something_that_varies():
    with pytest.raises(UserError, match="nothing varies"):
        indices_of(ishigami, {}, ["f"], 8, 0)
