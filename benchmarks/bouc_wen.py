"""How well does the package know a hysteretic oscillator?  `python benchmarks/bouc_wen.py [--data FOLDER]`

The Bouc–Wen benchmark of Noël & Schoukens (Hysteretic benchmark with a dynamic nonlinearity, 2016): a mass on a linear spring
with a Bouc–Wen element, driven by a force, its displacement measured at 750 Hz.  Models are calibrated on the estimation data
alone, from studies that anybody could write, and judged on the multisine test: e_RMS, the root mean square of what is predicted
less what is measured [m], as the benchmark asks.

**What the records are.**  Both signals are multisines, with every line from 5 to 150 Hz at one amplitude, of a period of 8192
samples.  The estimation record is four periods of one realisation, sample for sample the same force (not independent
realisations), with noise of 7.3e-6 m of its own in each; the test is one period of another, without noise.  Both are *settled*:
a record starts in the middle of the motion, not at rest (its first displacement is that of the next period), while the package
simulates from rest at the first sample and scores from `from` on.  So an experiment here is two periods, of which the second
counts, and what is measured there is the mean of the periods there are (3.7e-6 m of noise are left in the estimation data).

**What the force is between the samples.**  The package interpolates a recorded ground motion by a cubic spline and not by lines
(`hsed_jax.inference.observation`), which gives back 99.5 % of a line at 150 Hz, and it divides the samples into as many steps as
the stiffest law within the priors needs.  `refined` is the same model with the force given eight times as densely, by its
Fourier series.  With the parameters that the data were made with, e_RMS is 2.9e-7 m by the spline in 5 steps to a sample, 2.5e-7
so refined, and 2.4e-7 with a force sixteen times as dense: there the error is that of the data's own integration (Newmark at
15 kHz).  A fit takes a part of that in; the noise of the estimation data leaves it an error of about 0.9e-7 m, 3.7e-6 m times the
root of 5 parameters over 8192 samples.
"""

import argparse
import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from run import machine

import hsed_jax as hx
from hsed_jax.analysis.calibration import Calibration
from hsed_jax.measurements.experiment import Noise

RESULTS = Path(__file__).with_suffix(".json")
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
PERIOD, RATE = 8192, 750.0
FORCE, MOTION = "ground_acceleration", "displacement_1"
# e_RMS on the multisine test [m] (README of the data).
PUBLISHED = {
    "linear": "best linear 1.7e-4",
    "structure found": "best learned 7.5e-6 to 8.9e-6",
    "structure given": "six parameters by LM 1.0e-7",
    "true parameters": "RK4 at 15 kHz 2.4e-7",
}
BEST_LEARNED = 7.5e-6
TRUE = {"A": 5e4, "beta": 800.0, "gamma": -1100.0, "structure.stiffness_1": 5e4, "structure.alpha": 5.0}

# A mass of 2 kg is given with the data; 95 % of a stiffness are from 4 to 270 kN/m.
_STIFFNESS = {"lognormal": [10.4, 1.05]}
_COMMON: dict[str, Any] = {
    "seed": 0,
    "structure": {
        "masses": [2.0],
        "specimen": {"between": ["ground", 1]},
        # C = αM: a dashpot to the ground.
        "damping": {
            "rayleigh": {"alpha": {"lognormal": [1.0, 1.5]}, "beta": 0.0},
            "specimen_stiffness": 1.0e5,
        },
    },
    # As `campaign_of` has it.
    "experiments": {"campaign": "bouc_wen_benchmark"},
    "observe": "histories",
    "steps": ["calibrate", "compare"],
    "calibration": {"sampler": "laplace", "starts": 8},
}
LINEAR: dict[str, Any] = {
    **_COMMON,
    "study": "linear",
    "model": {"spring": "elastic", "parameters": {"k": _STIFFNESS}},
}
GIVEN: dict[str, Any] = {
    **_COMMON,
    "study": "structure given",
    "structure": {**_COMMON["structure"], "springs": [{"between": ["ground", 1], "stiffness": _STIFFNESS}]},
    "model": {
        "spring": "bouc_wen",
        # Softening or hardening, thin loops or full ones: γ of either sign, β from none to the yielding of a millimetre's tenth.
        "parameters": {"A": _STIFFNESS, "beta": {"lognormal": [5.0, 2.0]}, "gamma": {"normal": [0.0, 3.0e3]}},
    },
}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER", help="holds the folder bouc_wen_benchmark")
    parser.add_argument("--markdown", action="store_true", help="the table of the last results, nothing measured")
    parser.add_argument("--output", type=Path, default=RESULTS, metavar="FILE.json")
    options = parser.parse_args()
    if not options.markdown:
        campaign = campaign_of(options.data / "bouc_wen_benchmark")
        results = {"machine": machine(), "signal": signal(campaign), "rows": measured(campaign)}
        options.output.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(markdown(json.loads(options.output.read_text(encoding="utf-8"))))


def measured(campaign: hx.Campaign) -> list[dict[str, Any]]:
    """A row for each model."""
    linear, given = calibrated(LINEAR, campaign), calibrated(GIVEN, campaign)
    rows = [row("linear", linear, campaign), found(linear[0], campaign), row("structure given", given, campaign)]
    return [*rows, known(given[0], campaign)]


def signal(campaign: hx.Campaign) -> float:
    """Root mean square of the test signal about its mean [m]."""
    (test,) = campaign.test.experiments
    assert test.record is not None
    return float(np.std(test.record[MOTION][np.asarray(test.in_window)]))


def in_units_of_the_signal() -> dict[str, float]:
    """Errors on the test signal over its root mean square: linear model, structure found beside it, best published one."""
    results = json.loads(RESULTS.read_text(encoding="utf-8"))
    errors = {row["model"]: row["test"] / results["signal"] for row in results["rows"]}
    return {
        "linear": errors["linear"],
        "found": errors["structure found"],
        "published": BEST_LEARNED / results["signal"],
    }


def campaign_of(folder: Path) -> hx.Campaign:
    """The benchmark as a campaign of settled experiments."""
    raw = hx.read_campaign(folder)
    experiments = {e.id: _settled(e) for e in raw}
    record = next(e for e in raw if e.split == "train").record
    assert record is not None
    periods = len(record) // PERIOD
    noise = raw.channels[MOTION].noise
    assert noise is not None and noise.absolute is not None
    # The noise of the mean of the periods.
    channel = replace(raw.channels[MOTION], noise=Noise(absolute=noise.absolute / np.sqrt(periods)))
    return replace(raw, experiments=tuple(experiments.values()), channels={**raw.channels, MOTION: channel})


def _settled(experiment: hx.Experiment) -> hx.Experiment:
    """A period that forgets the rest it starts from, and one that counts."""
    assert experiment.record is not None
    force, motion = (experiment.record[name].reshape(-1, PERIOD) for name in (FORCE, MOTION))
    assert np.ptp(force, axis=0).max() < 1e-9, "the periods differ"
    return _recorded(experiment, np.tile(force[0], 2), np.tile(motion.mean(axis=0), 2), RATE)


def _recorded(experiment: hx.Experiment, force: np.ndarray, motion: np.ndarray, rate: float) -> hx.Experiment:
    times = np.arange(len(force)) / rate
    record = hx.Record(times, {FORCE: force, MOTION: motion})
    return replace(experiment, record=record, window=(times[len(times) // 2], times[-1]))


def refined(campaign: hx.Campaign, factor: int) -> hx.Campaign:
    """The same experiments, their signals between the samples as their Fourier series have them."""

    def denser(experiment: hx.Experiment) -> hx.Experiment:
        from scipy.signal import resample

        assert experiment.record is not None
        size = factor * len(experiment.record)
        signals = (np.asarray(resample(experiment.record[name], size)) for name in (FORCE, MOTION))
        return _recorded(experiment, *signals, rate=factor * RATE)

    return replace(campaign, experiments=tuple(denser(e) for e in campaign))


def calibrated(study: Mapping[str, Any], campaign: hx.Campaign) -> tuple[Calibration, float]:
    """The calibrated model, and the seconds that it took, compilation included."""
    begin = time.perf_counter()
    fit = hx.calibrate(hx.load_study(dict(study)), campaign)
    return fit, time.perf_counter() - begin


def row(model: str, calibrated: tuple[Calibration, float], campaign: hx.Campaign) -> dict[str, Any]:
    """What came out of one calibration."""
    fit, seconds = calibrated
    at = np.asarray(fit.fit.maximum.theta)
    return {
        "model": model,
        "test": e_rms(fit, at, campaign.test),
        "refined": e_rms(fit, at, refined(campaign.test, 8)),
        "estimation": e_rms(fit, at, campaign.train),
        "seconds": seconds,
        "map": fit.map,
        "sd": {name: told["sd"] for name, told in fit.fit.summary().items()},
        "chi2_per_datum": fit.fit.chi2_per_datum,
    }


def found(linear: Calibration, campaign: hx.Campaign) -> dict[str, Any]:
    """What the diagnosis of the linear model names, and the model with it; the test signal takes no part."""
    begin = time.perf_counter()
    diagnosis = hx.diagnose(linear, campaign.train)
    named = {"effects": diagnosis.effects, "forms": diagnosis.forms, "start": diagnosis.optimum}
    better = hx.improve(linear, campaign.train, **named).calibration
    named = {"verdict": diagnosis.sentence, "effects": diagnosis.effects, "forms": diagnosis.forms}
    return row("structure found", (better, time.perf_counter() - begin), campaign) | named


def known(fit: Calibration, campaign: hx.Campaign) -> dict[str, Any]:
    """The same structure with the parameters that the data were made with."""
    at = np.asarray([TRUE[name] for name in fit.fit.names])
    errors = {"test": e_rms(fit, at, campaign.test), "refined": e_rms(fit, at, refined(campaign.test, 8))}
    return {"model": "true parameters", **errors, "estimation": e_rms(fit, at, campaign.train), "map": TRUE}


def e_rms(fit: Calibration, theta: np.ndarray, campaign: hx.Campaign) -> float:
    """Root mean square of what a model predicts less what was measured, in the windows of a campaign [m]."""
    built = replace(fit.built, campaign=campaign)
    data = built.inference.data(campaign, campaign.experiments)
    predicted, ok = built.inference.posterior.predict(jnp.asarray(theta), data.conditions, data.count)
    assert np.all(ok)
    used = np.asarray(data.weights) > 0
    return float(np.sqrt(np.mean((np.asarray(predicted) - np.asarray(data.values))[used] ** 2)))


def markdown(results: Mapping[str, Any]) -> str:
    """The table of the results."""
    heads = ("model", "e_RMS multisine [m]", "published [m]", "e_RMS, force 8 times as dense [m]", "s")
    lines = [heads, ("---",) * len(heads)]
    for one in results["rows"]:
        seconds = f"{one['seconds']:.0f}" if "seconds" in one else "–"
        test, fine = (f"{one[name]:.2e}" for name in ("test", "refined"))
        lines.append((one["model"], test, PUBLISHED[one["model"]], fine, seconds))
    m = results["machine"]
    said = f"{m['cpu']}, {m['cores']} cores (load {m['load']:.1f} at the end), {m['date']}; Python {m['python']}."
    return "\n".join(["| " + " | ".join(line) + " |" for line in lines] + ["", said])


if __name__ == "__main__":
    main()
