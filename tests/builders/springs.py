"""Cyclic tests of a Bouc–Wen spring with a dashpot, made without the package, and the study of the spring alone."""

import numpy as np

import hsed_jax as hx
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, Record

A, BETA, C = 2.0e7, 200.0, 3.0e5  # strength 100 kN, yield elongation 5 mm; the dashpot carries up to 30 kN
NOISE = 1.5e3
SAMPLES = 120


def exact_force(time, elongation, rate, c, parts=50):
    """Bouc–Wen with γ = 0, n = 1: on a monotone step z relaxes to ±A/β over the way; and a dashpot beside it."""
    dense = np.linspace(time[0], time[-1], (time.size - 1) * parts + 1)
    z = np.zeros(dense.size)
    for k, du in enumerate(np.diff(elongation(dense))):
        limit = np.sign(du) * A / BETA
        z[k + 1] = limit + (z[k] - limit) * np.exp(-BETA * abs(du))
    return z[::parts] + c * rate(time)


def spring_campaign(c, seed=0, noise=NOISE) -> Campaign:
    """Cyclic tests of different speed and amplitude, the last of them kept for testing."""
    experiments = []
    for number, (frequency, amplitude) in enumerate(((0.4, 0.02), (1.0, 0.014), (0.2, 0.03), (0.7, 0.018))):
        time = np.linspace(0.0, 5.0 / frequency, SAMPLES)
        omega, growth = 2 * np.pi * frequency, frequency / 5.0

        def elongation(t, a=amplitude, w=omega, g=growth):
            return a * (0.2 + 0.8 * g * t) * np.sin(w * t)

        def rate(t, a=amplitude, w=omega, g=growth):
            return a * (0.8 * g * np.sin(w * t) + (0.2 + 0.8 * g * t) * w * np.cos(w * t))

        force = exact_force(time, elongation, rate, c)
        force += noise * np.random.default_rng([seed, number]).standard_normal(SAMPLES)
        record = Record(time, {"elongation": elongation(time), "force": force})
        experiments.append(Experiment(f"E0{number + 1}", record=record, split="test" if number == 3 else "train"))
    channels = {
        "time": Channel("time", "s"),
        "elongation": Channel("elongation", "mm"),
        "force": Channel("force", "kN", noise=Noise(absolute=noise)),
    }
    return Campaign("springs", "displacement", {}, channels, {}, tuple(experiments))


def spring_study(**changes):
    return hx.load_study(
        {
            "study": "springs",
            "model": {
                "parameters": {
                    "A": {"lognormal": [np.log(1.4 * A), 0.7]},
                    "beta": {"lognormal": [np.log(0.7 * BETA), 0.7]},
                    "gamma": 0.0,
                    "n": 1.0,
                }
            },
            "experiments": {"campaign": "nowhere"},
            "observe": "histories",
            "steps": ["calibrate", "compare"],
            **changes,
        }
    )
