"""Records of tests as they should be, for doubts to be put into: a shaken specimen, and one in growing cycles."""

import numpy as np

from hsed_jax.measurements import Campaign, Record

# Noise of the sensors of a shaken specimen [m] and [N].
SIGMA = {"elongation": 2e-5, "force": 50.0}


def clean(seed: int = 0, noise: float = 1.0) -> dict[str, np.ndarray]:
    """A second at rest, then a slow burst of a hysteretic specimen, sampled at 200 Hz with white noise."""
    draw = np.random.default_rng(seed)
    time = np.arange(2000) * 0.005
    burst = np.where(time > 1, np.sin(2 * np.pi * (time - 1)) * np.sin(np.pi * np.clip((time - 1) / 9, 0, 1)), 0.0)
    elongation = 0.03 * burst
    force = np.zeros_like(time)  # elastoplastic, rounded
    for i in range(1, time.size):
        step = elongation[i] - elongation[i - 1]
        force[i] = force[i - 1] + 1e6 * step * (
            1 - (0.5 + 0.5 * np.sign(force[i - 1] * step)) * abs(force[i - 1] / 1e4)
        )
    return {
        "time": time,
        "ground_acceleration": 3.0 * burst + noise * 0.002 * draw.normal(size=time.size),
        "elongation": elongation + noise * SIGMA["elongation"] * draw.normal(size=time.size),
        "force": force + noise * SIGMA["force"] * draw.normal(size=time.size),
    }


def loop(cycles=(2, 2, 4, 4, 8, 8, 12, 12), samples=60, noise=0.0, seed=0) -> dict[str, np.ndarray]:
    """A rounded elastoplastic specimen in growing cycles, without a time, [m] and [N]."""
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(samples) / samples) for a in cycles]) * 1e-3
    force = np.zeros_like(u)
    for i in range(1, u.size):
        step = u[i] - u[i - 1]
        force[i] = force[i - 1] + 1e7 * step * (
            1 - (0.5 + 0.5 * np.sign(force[i - 1] * step)) * abs(force[i - 1] / 3e4)
        )
    draw = np.random.default_rng(seed)
    return {
        "elongation": u + noise * 1e-5 * draw.normal(size=u.size),
        "force": force + noise * 100 * draw.normal(size=u.size),
    }


def in_mm(data: dict[str, np.ndarray], rate: float | None = None, **more) -> Campaign:
    """The same as a campaign in mm and kN, with a time where there is a rate [samples/s]."""
    record = {"elongation": 1e3 * data["elongation"], "force": 1e-3 * data["force"]}
    channels = {"elongation": "mm", "force": "kN"}
    if rate is not None:
        record["time"], channels["time"] = np.arange(record["force"].size) / rate, "s"
    return Campaign.from_frames(records={"E01": record}, protocol="displacement", channels=channels)


def as_record(data) -> Record:
    return Record(np.arange(data["force"].size, dtype=float), data)
