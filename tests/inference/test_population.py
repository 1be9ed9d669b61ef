"""Populations of specimens: the map and its derivatives, posteriors known in closed form, strangers, files, clear messages."""

import dataclasses
import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
import yaml

import hsed_jax as hx
from hsed_jax.analysis.calibration import calibrate_built
from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.inference.distributions import map_to
from hsed_jax.inference.expansion import expand
from hsed_jax.inference.population import Level, Population, Varying, spread_scaling
from hsed_jax.inference.priors import Prior
from hsed_jax.study.build import Built

pytestmark = pytest.mark.whole

FUNCTIONS = '''
def level(parameters, inputs):
    """As strong as it is, and a slope that all share."""
    return {"peak_force": parameters["a"] + parameters["b"] * inputs["x"]}
'''
SIGMA, WIDE, SPREAD = 0.3, 10.0, 2.0
# Two mills of three bars; of the last one nothing is fitted.
BARS = {"A1": 0.9, "A2": 1.4, "A3": -0.2, "B1": -1.3, "B2": 0.1, "B3": -0.9}
EACH = 4
STUDY = {
    "study": "bars",
    "inputs": {"x": {"uniform": [-1.0, 1.0]}},
    "model": {
        "function": "mine.py:level",
        "parameters": {"a": {"normal": [0.0, WIDE], "unit": "N"}, "b": {"normal": [0.0, WIDE], "unit": "N"}},
        "levels": {"bar": {"a": {"half_normal": SPREAD}}},
    },
    "experiments": {"campaign": "campaign"},
    "quantities": ["peak_force"],
    "calibration": {"warmup": 200, "draws": 1000},
    "steps": ["calibrate", "compare"],
}


def rows() -> list[tuple[str, float, float, str]]:
    random, found = np.random.default_rng(4), []
    for bar, own in BARS.items():
        for number in range(EACH):
            x = float(random.uniform(-1, 1))
            y = 5.0 + own + 2.0 * x + SIGMA * float(random.standard_normal())
            found.append((f"{bar}_{number}", x, y, bar))
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A campaign of six bars of two mills, one of them for testing alone."""
    path = tmp_path_factory.mktemp("bars")
    (path / "mine.py").write_text(FUNCTIONS, encoding="utf-8")
    (path / "campaign").mkdir()
    (path / "campaign" / "campaign.yaml").write_text(
        f"name: bars\nprotocol: ground_motion\ninputs: {{x: '1'}}\n"
        f"quantities: {{peak_force: {{column: F, unit: N, noise: {SIGMA}}}}}\n"
    )
    lines = ["id,x,F,split,mill,bar,empty"]
    for id, x, y, bar in rows():
        split, filled = ("test", "") if bar == "B3" else ("train", "yes")
        lines.append(f"{id},{x!r},{y!r},{split},{bar[0]},{bar},{filled if id == 'A1_0' else ''}")
    (path / "campaign" / "experiments.csv").write_text("\n".join(lines) + "\n")
    return path


def study_of(folder: Path, changes=(), **more):
    """The study, in the folder."""
    (folder / "study.yaml").write_text(yaml.safe_dump({**STUDY, **more}), encoding="utf-8")
    return load_study(folder / "study.yaml", list(changes))


@pytest.fixture(scope="module")
def calibration(folder):
    return hx.calibrate(study_of(folder, ["calibration.sampler=nuts"]))


def quadrature():
    """Names of the fitted bars; spreads on a grid and their probabilities; given each, mean and covariance of a, b and bars."""
    fitted = [row for row in rows() if row[3] != "B3"]
    bars = list(dict.fromkeys(row[3] for row in fitted))
    x, y = (np.asarray([row[k] for row in fitted]) for k in (1, 2))
    design = np.zeros((len(fitted), 2 + len(bars)))
    design[:, 0], design[:, 1] = 1.0, x
    design[np.arange(len(fitted)), [2 + bars.index(row[3]) for row in fitted]] = 1.0
    spreads = np.linspace(0.005, 10.0, 4000)
    heights, means, covariances = [], [], []
    for spread in spreads:
        prior = np.diag([WIDE**2, WIDE**2, *[spread**2] * len(bars)])
        marginal = design @ prior @ design.T + SIGMA**2 * np.eye(len(y))
        gain = prior @ design.T @ np.linalg.inv(marginal)
        means.append(gain @ y)
        covariances.append(prior - gain @ design @ prior)
        size = np.linalg.slogdet(marginal)[1]
        heights.append(-0.5 * y @ np.linalg.solve(marginal, y) - 0.5 * size - 0.5 * (spread / SPREAD) ** 2)
    weights = np.exp(heights - np.max(heights))
    return bars, spreads, weights / weights.sum(), means, covariances


def exact() -> tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]], tuple[float, float]]:
    """Mean and sd of a, b and the spread; of every fitted bar; of one that nobody knows: by quadrature over the spread."""
    bars, spreads, weights, means, covariances = quadrature()
    own = np.zeros((3 + len(bars), 2 + len(bars)))
    own[0, 0] = own[1, 1] = own[-1, 0] = 1.0
    own[2:-1, 0], own[2:-1, 2:] = 1.0, np.eye(len(bars))
    each = np.stack(means) @ own.T
    variances = np.stack([np.diag(own @ c @ own.T) for c in covariances])
    variances[:, -1] += spreads**2  # of a stranger the spread itself
    mean = weights @ each
    sd = np.sqrt(weights @ (variances + (each - mean) ** 2))
    at = weights @ spreads
    told = list(zip(mean.tolist(), sd.tolist(), strict=True))
    centre = {"a": told[0], "b": told[1], "bar.a.spread": (at, float(np.sqrt(weights @ (spreads - at) ** 2)))}
    return centre, dict(zip(bars, told[2:-1], strict=True)), told[-1]


def test_a_population_of_normals_has_the_posterior_of_quadrature(calibration):
    found, levels = calibration.fit.summary(), calibration.fit.levels()
    assert calibration.fit.warning is None and calibration.fit.chains.sampler == "nuts"
    assert set(found) == {"a", "b", "bar.a.spread"} and set(levels) == {"bar"} and set(levels["bar"]) == {"a"}
    told = levels["bar"]["a"]
    assert told["mean"] == found["a"] and told["spread"] == found["bar.a.spread"]
    centre, bars, _ = exact()
    assert set(told["of"]) == set(bars)
    for name, (mean, sd) in {**centre, **bars}.items():
        of_it = {**found, **told["of"]}[name]
        ess = found[name]["ess_bulk"] if name in found else 1000.0
        assert of_it["mean"] == pytest.approx(mean, abs=4 * sd / np.sqrt(ess)), name
        assert of_it["sd"] == pytest.approx(sd, rel=5 / np.sqrt(2 * ess)), name
    assert "a of bar A1" in str(calibration)


def test_a_bar_that_was_never_tested_is_predicted_from_the_population(calibration):
    _, bars, (mean, sd) = exact()
    prediction, b = calibration.test, calibration.map["b"]
    x = np.asarray([experiment.inputs["x"] for experiment in prediction.experiments])
    # Of 64 draws.
    np.testing.assert_allclose(prediction.mean[:, 0], mean + b * x, atol=4 * sd / 8)
    np.testing.assert_allclose(prediction.sd[:, 0], np.hypot(sd, SIGMA), rtol=0.4)
    np.testing.assert_allclose(prediction.predicted[:, 0], calibration.map["a"] + b * x)
    known = calibration.train
    assert known.sd.max() < 2 * np.hypot(max(sd for _, sd in bars.values()), SIGMA) < prediction.sd.min()


def test_the_map_and_its_coordinates_are_what_finite_differences_say(folder):
    study = study_of(folder, ["model.levels={mill: {a: {half_normal: 2.0}}, bar: [a, b]}"])
    built = Built(study)
    campaign = built.experiments.measured
    data = built.inference.data(campaign, campaign.train.experiments)
    plain, random = built.inference.posterior, np.random.default_rng(0)
    posterior = eqx.tree_at(
        lambda p: (p.population.told, p.population.reference),
        plain,
        tuple(tuple(jnp.asarray(random.uniform(0, 1, x.shape)) for x in xs)
              for xs in (plain.population.told, plain.population.reference)),
    )  # fmt: skip
    u = jnp.asarray(0.5 * random.standard_normal(len(posterior.names)))

    def difference(function, step=1e-5):
        sides = [np.stack([np.asarray(function(u + s * step * e)) for e in np.eye(u.size)], axis=-1) for s in (1, -1)]
        return (sides[0] - sides[1]) / (2 * step)

    theta = posterior.constrain(u)
    np.testing.assert_allclose(posterior.unconstrain(theta), u, atol=1e-12)
    outputs = lambda x: posterior.predictions(x, data)[0]  # noqa: E731
    np.testing.assert_allclose(jax.jacfwd(outputs)(u), difference(outputs), atol=1e-7)
    density = lambda x: posterior.log_density(x, data)  # noqa: E731
    (found,) = expand(posterior, data, [np.asarray(u)])
    np.testing.assert_allclose(found.gradient, difference(density), rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(found.gradient, jax.grad(density)(u), rtol=1e-9)
    assert np.linalg.eigvalsh(found.curvature).min() > 0
    # Coordinates change volumes, and no density of θ.
    volume = np.linalg.slogdet(np.asarray(jax.jacfwd(posterior.constrain)(u)))[1]
    assert float(density(u)) == pytest.approx(float(posterior.log_posterior(u, data)) + volume, rel=1e-12)
    assert float(plain.log_posterior(plain.unconstrain(theta), data)) == pytest.approx(
        float(posterior.log_posterior(u, data)), rel=1e-12
    )
    # By hand: the bars lie within the mills.
    mills, bars = ([*level.members] for level in posterior.population.levels)
    at = dict(zip(posterior.names, np.asarray(theta).tolist(), strict=True))
    for row, e in enumerate(campaign.train):
        mill, bar = e.metadata["mill"], e.metadata["bar"]
        a = at["a"] + at["mill.a.spread"] * at[f"mill.a.{mill}"] + at["bar.a.spread"] * at[f"bar.a.{bar}"]
        b = at["b"] + at["bar.b.spread"] * at[f"bar.b.{bar}"]
        assert float(outputs(u)[row, 0]) == pytest.approx(a + b * e.inputs["x"], rel=1e-12)
    members = np.asarray(data.members)
    of_mills, of_bars = posterior.population.of_members(theta, posterior.of_model(theta), members)
    assert float(of_mills[1, 0]) == pytest.approx(at["a"] + at["mill.a.spread"] * at[f"mill.a.{mills[1]}"])
    assert float(of_mills[1, 1]) == at["b"]
    shift = at["mill.a.spread"] * at["mill.a.B"] + at["bar.a.spread"] * at["bar.a.B2"]
    assert float(of_bars[bars.index("B2"), 0]) == pytest.approx(at["a"] + shift)


def test_a_positive_parameter_varies_by_its_logarithm_and_stays_within_what_its_law_allows():
    level = Level("bar", ("x", "y"), (Varying("k", 0, True, Prior("half_normal", 0.3), 0.0, 3.0),))
    population = Population([level], 2)
    theta = jnp.asarray([2.0, 7.0, 0.5, -1.0, 4.0])  # k, another, the spread, two offsets
    own = population.own(theta, theta[:2], jnp.asarray([[0], [1], [2]]), (jnp.asarray([[1.0]]) * 0.5,))
    np.testing.assert_allclose(own, [[2 * np.exp(-0.5), 7.0], [3.0, 7.0], [2 * np.exp(0.25), 7.0]])


def test_the_map_is_where_the_spread_alone_is_most_probable(calibration):
    bars, spreads, weights, *_ = quadrature()
    prior = Prior("half_normal", SPREAD)
    u = np.asarray(map_to(prior.distribution, spread_scaling(prior)).inv(jnp.asarray(spreads)))
    most = spreads[np.argmax(weights * np.gradient(spreads, u))]
    # A centre at its best takes one of the bars' degrees of freedom; the joint density of spread and offsets has no such place.
    most *= np.sqrt(1 - 1 / len(bars))
    assert calibration.map["bar.a.spread"] == pytest.approx(most, rel=0.05)


def test_offsets_are_centred_where_measurements_tell_them(folder, calibration):
    told = np.asarray(calibration.fit.posterior.population.told[0])
    np.testing.assert_allclose(told, SIGMA / np.sqrt(EACH), rtol=0.1)
    few = study_of(folder, ["error={absolute: 30.0}"])
    built = Built(few)
    hardly = calibrate_built(built, built.experiments.measured, start=jnp.asarray([5.0, 2.0]))
    assert np.asarray(hardly.fit.posterior.population.told[0]).min() > hardly.map["bar.a.spread"]
    assert hardly.fit.warning is None
    # Nothing was learned: the spread is as its prior has it.
    assert hardly.fit.summary()["bar.a.spread"]["mean"] == pytest.approx(SPREAD * np.sqrt(2 / np.pi), rel=0.1)


def test_a_run_writes_its_levels_and_goes_on_where_it_was(folder, tmp_path, calibration):
    study_of(folder, calibration={"warmup": 200, "draws": 200, "chains": 2})
    out = tmp_path / "run"
    assert main(["run", str(folder / "study.yaml"), "--output", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    told = summary["calibration"]["levels"]["bar"]["a"]
    assert set(told) == {"mean", "spread", "of", "untested"} and set(told["of"]) == {"A1", "A2", "A3", "B1", "B2"}
    assert {"mean", "sd", "q05", "q95"} <= set(told["of"]["A1"]) and set(summary["calibration"]["map"]) == {
        "a", "b", "bar.a.spread"}  # fmt: skip
    with xr.open_datatree(out / "results.nc", engine="h5netcdf") as tree:
        own = tree["posterior"]["bar.a"]
        assert own.dims == ("chain", "draw", "bar") and list(own["bar"].values) == list(told["of"])
        assert float(own.sel(bar="A2").mean()) == pytest.approx(told["of"]["A2"]["mean"])
    assert (out / "figures" / "population_bar.png").is_file() and "population_bar" in (out / "report.html").read_text()
    written = yaml.safe_load((out / "study.yaml").read_text())
    assert written["model"]["levels"] == {"bar": {"a": {"half_normal": SPREAD}}}
    (out / "summary.json").unlink()
    assert main(["run", str(folder / "study.yaml"), "--output", str(out), "--resume"]) == 0
    again = json.loads((out / "summary.json").read_text())
    assert again["calibration"] == summary["calibration"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            ["model.levels={batch: [a]}"],
            r"model\.levels\.batch: experiments\.csv has no such column; it has id, mill, bar",
        ),
        (["model.levels={bar: [c]}"], r"model\.levels\.bar\.c: 'c' is not a calibrated parameter; those are a, b"),
        (["model.levels={empty: [a]}"], r"model\.levels\.empty: experiment 'A1_1' has no empty"),
        (["model.levels={bar: {a: {normal: [0, 1]}}}"], r"model\.levels\.bar\.a: a spread cannot be negative"),
        (["model.levels={bar: [a, a]}"], r"model\.levels\.bar: this is a list of parameters, each once"),
        (["model.levels={bar: []}"], r"model\.levels\.bar: this must not be empty"),
        (["model.levels={bar: {a: 0.2}}"], r"model\.levels\.bar\.a: a spread has a prior, such as"),
        (["model.levels={bar: [a]}", "model.parameters.a=3.0"], r"'a' is not a calibrated parameter; those are b"),
        (["steps=[design, calibrate]"], r"model\.levels: a design plans experiments of one specimen"),
    ],
)
def test_what_cannot_be_is_one_clear_message(folder, changes, message):
    with pytest.raises(UserError, match=message):
        Built(study_of(folder, changes)).check()


def test_levels_need_a_campaign_and_members(folder):
    virtual = load_study("configs/paper.yaml", ["model.levels={bar: [A]}", "steps=[calibrate]"])
    with pytest.raises(UserError, match=r"model\.levels: a column of experiments\.csv gives the members"):
        Built(virtual).check()
    study = study_of(folder)
    campaign = Built(study).experiments.measured
    one = dataclasses.replace(campaign, experiments=campaign.experiments[:EACH])
    with pytest.raises(UserError, match=r"needs at least two members, and the training experiments have only 'A1'"):
        hx.calibrate(study, one)
