"""Which law a first study has: laws beside springs, friction and dashpots, by other programs than those that are fitted."""

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from laws_in_steps import MenegottoPinto

from hsed_jax.drafting.first_law import Residuals, residuals
from hsed_jax.measurements import Campaign, Channel, Experiment, Record

K, F_Y, TURNS = 1e7, 8e4, np.repeat([5, 10, 15, 20, 25, 30], 2) * 1e-3
NOISE = 0.01


def path() -> tuple[np.ndarray, np.ndarray]:
    """Time and elongation of sinusoidal cycles."""
    phase = np.linspace(0, 2 * np.pi, 101)[1:]
    elongation = np.concatenate([[0.0], *(a * np.sin(phase) for a in TURNS)])
    return 0.02 * np.arange(len(elongation)), elongation


def steel(elongation: np.ndarray) -> np.ndarray:
    law, force = MenegottoPinto(k=K, F_y=F_Y, b=0.02, R0=15.0, cR1=0.925, cR2=0.15), [0.0]
    for a, b in pairwise(elongation):
        force += [law.move(u) for u in np.linspace(a, b, 11)[1:]][-1:]
    return np.asarray(force)


def bouc_wen(elongation: np.ndarray, n: float, share: float) -> np.ndarray:
    """The force over its bound follows an equation along the path, in small steps of Euler."""
    z, force = 0.0, [0.0]
    for a, b in pairwise(elongation):
        for _ in range(200):
            step = (b - a) / 200
            z += K / F_Y * step * (1 - abs(z) ** n * (np.sign(z * step) + share) / (1 + share))
        force.append(F_Y * z)
    return np.asarray(force)


def beside(kind: str, time: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A force in parallel."""
    if kind == "contact":
        return 2 * K * np.sign(u) * np.maximum(np.abs(u) - 18e-3, 0)
    if kind == "stop":
        return 5 * K * np.maximum(u - 16.3e-3, 0)
    if kind == "friction":
        return 2e4 * np.sign(np.diff(u, prepend=0.0))
    if kind == "dashpot":
        rate = np.gradient(u, time)
        return 6e4 * np.sign(rate) * np.abs(rate / np.max(np.abs(rate))) ** 0.7
    return np.zeros_like(u)


def campaign(force: np.ndarray) -> Campaign:
    time, elongation = path()
    noise = NOISE * np.sqrt(np.nanmean(force**2)) * np.random.default_rng(0).normal(size=len(force))
    channels = {"time": Channel("time", "s"), "elongation": Channel("elongation", "m"), "force": Channel("force", "N")}
    record = Record(time, {"elongation": elongation, "force": force + noise})
    return Campaign("made", "displacement", channels=channels, experiments=(Experiment("one", record=record),))


@pytest.mark.parametrize("kind", ["nothing", "contact", "stop", "friction", "dashpot"])
def test_steel_is_found_whatever_stands_beside_it(kind):
    time, elongation = path()
    found = residuals(campaign(steel(elongation) + beside(kind, time, elongation)), 2 * K, 1.3 * F_Y)
    assert found is not None and found.is_steel
    # Its own law leaves the noise and what the terms beside it cannot be.
    assert found.steel < 3 * NOISE < found.simplest


@pytest.mark.parametrize("kind", ["nothing", "contact", "friction", "dashpot"])
@pytest.mark.parametrize(("n", "share"), [(1.0, 0.0), (1.0, 1.0), (2.0, 1.0)])
def test_the_law_of_bouc_and_wen_stays_where_it_is_the_specimens(kind, n, share):
    time, elongation = path()
    found = residuals(campaign(bouc_wen(elongation, n, share) + beside(kind, time, elongation)), 2 * K, 1.3 * F_Y)
    assert found is not None and not found.is_steel
    assert found.shaped < 3 * NOISE
    if (n, share) == (1.0, 0.0):
        assert found.simplest < 3 * NOISE


def test_steel_is_chosen_where_it_leaves_little_and_much_less_than_the_others():
    assert Residuals(simplest=0.08, shaped=0.07, steel=0.04).is_steel
    assert not Residuals(simplest=0.08, shaped=0.03, steel=0.04).is_steel
    # Every law of a linear specimen leaves the noise alone.  Every law of a pinched specimen leaves much.
    assert not Residuals(simplest=0.05, shaped=0.05, steel=0.045).is_steel
    assert not Residuals(simplest=0.2, shaped=0.19, steel=0.09).is_steel


def test_friction_that_sticks_first_is_no_steel():
    _, elongation = path()
    sliding, force = 0.0, [0.0]
    for a, b in pairwise(elongation):
        sliding = float(np.clip(sliding + 30 * K * (b - a), -2e4, 2e4))
        force.append(sliding)
    found = residuals(campaign(0.15 * K * elongation + np.asarray(force)), 0.3 * K, 6e4)
    assert found is not None and not found.is_steel


def test_without_histories_nothing_is_fitted():
    quantities = {"peak_force": Channel("peak_force", "N")}
    made = Campaign(
        "made", "ground_motion", quantities=quantities, experiments=(Experiment("one", quantities={"peak_force": F_Y}),)
    )
    assert residuals(made, K, F_Y) is None


def test_a_record_of_missing_samples_is_fitted_where_it_was_measured():
    force = steel(path()[1])
    force[100:160] = np.nan
    found = residuals(campaign(force), K, F_Y)
    assert found is not None and found.is_steel


@pytest.mark.whole
def test_the_command_chooses_the_law_in_a_process_of_its_own(tmp_path):
    time, elongation = path()
    table = np.stack([time, 1e3 * elongation, 1e-3 * steel(elongation)], axis=1)
    np.savetxt(tmp_path / "link.csv", table, delimiter=",", header="time [s],displacement [mm],force [kN]", comments="")
    subprocess.run(
        [sys.executable, "-m", "hsed_jax", "init", "link.csv"], cwd=tmp_path, check=True, capture_output=True
    )
    text = (tmp_path / "link" / "study.yaml").read_text(encoding="utf-8")
    assert "spring: menegotto_pinto" in text and "fits of the force leave" in text
