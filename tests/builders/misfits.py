"""Synthetic campaigns with their comparison and location, without a model."""

import numpy as np

from hsed_jax.criticism.compare import compare
from hsed_jax.criticism.locate import locate
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.measurements import Campaign, Channel, Experiment, Record

INPUTS = {"V_P": "cm/s", "T_P": "s", "scale": "-"}


def prediction(outputs, groups, experiments, measured, used=None):
    """One that is a little too strong, with noise of 5 % of the largest value."""
    used = np.ones(measured.shape, dtype=bool) if used is None else used
    known = np.where(used, measured, 0.0)
    sd = np.ones(measured.shape)
    for group in range(len(outputs)):
        sd[:, groups == group] = 0.05 * max(np.abs(known[:, groups == group]).max(), 1e-9)
    tables = 1.1 * np.nan_to_num(measured), 1.08 * np.nan_to_num(measured), 1.2 * sd, sd
    return Prediction(outputs, groups, tuple(experiments), known, used, *tables, np.ones(len(experiments), dtype=bool))


def histories(train=1, test=1, m=120, outputs=("force", "elongation"), protocol="ground_motion", inputs=0, time=True,
              window=False, change=None, id="E{}"):  # fmt: skip
    """Campaign, comparison and location of `train + test` experiments of up to `m` samples."""
    names = list(INPUTS)[:inputs]
    experiments = []
    for i in range(train + test):
        at = np.linspace(0, 8, m - i) if time else np.arange(m - i, dtype=float)
        phase = at * (2.0 if time else 0.2)
        elongation = (0.01 + 0.002 * i) * np.sin(phase) * (0.2 + phase / 20)
        channels = {"elongation": elongation, "force": 4e6 * elongation + 2e4 * np.cos(phase)}
        channels = {
            k: v for k, v in channels.items() if k in outputs or (k, protocol) == ("elongation", "displacement")
        }
        channels |= {k: 0.1 * np.cos(3 * phase) for k in outputs if k not in ("force", "elongation")}
        change and change(channels)
        at_inputs = {name: 0.3 + np.cos((3 + k) * i) for k, name in enumerate(names)}
        scored = (float(at[3]), float(at[len(at) // 2])) if window else None
        experiments.append(Experiment(id.format(i + 1), at_inputs, record=Record(at, channels), window=scored,
                                      split="train" if i < train else "test"))  # fmt: skip
    units = {"time": "s", "force": "kN", "elongation": "mm", "velocity_1": "m/s", "displacement_1": "mm",
             "acceleration_1_absolute": "m/s^2"}  # fmt: skip
    declared = {
        name: Channel(name, units[name]) for name in (*(("time",) if time else ()), *experiments[0].record.channels)
    }
    campaign = Campaign("synthetic", protocol, {n: INPUTS[n] for n in names}, declared,
                        experiments=tuple(experiments))  # fmt: skip
    return campaign, *compared(campaign, outputs, np.repeat(np.arange(len(outputs)), m), m)


def quantities(train=9, test=3, outputs=("peak_force", "dissipated_energy"), inputs=2, scale=None):
    """Campaign, comparison and location of experiments with quantities alone."""
    names, rng = list(INPUTS)[:inputs], np.random.default_rng(1)
    experiments = []
    for i in range(train + test):
        at = {name: float(x) for name, x in zip(names, rng.random(inputs), strict=True)}
        size = 1 + sum(at.values()) ** 2 if scale is None else scale
        values = {name: size * (2e5 if name == "peak_force" else 3e4) for name in outputs}
        experiments.append(Experiment(f"E{i + 1}", at, quantities=values, split="train" if i < train else "test"))
    declared = {"peak_force": Channel("peak_force", "kN"), "dissipated_energy": Channel("dissipated_energy", "kJ")}
    campaign = Campaign("synthetic", "ground_motion", {n: INPUTS[n] for n in names},
                        quantities={name: declared[name] for name in outputs}, experiments=tuple(experiments))  # fmt: skip
    return campaign, *compared(campaign, outputs, np.arange(len(outputs)), 1)


def compared(campaign, outputs, groups, m):
    """As `analysis.compare` and `analysis.locate` do, without a model."""

    def of(experiments):
        if not len(experiments):
            return None
        measured = np.full((len(experiments), groups.size), np.nan)
        for row, e in zip(measured, experiments, strict=True):
            for i, name in enumerate(outputs):
                values = (
                    [e.quantities.get(name, np.nan)]
                    if e.record is None
                    else np.where(e.in_window, e.record[name], np.nan)
                )
                row[i * m : i * m + len(values)] = values
        return prediction(outputs, groups, experiments, measured, np.isfinite(measured))

    train, test = of(campaign.train.experiments), of(campaign.test.experiments)
    return compare(train, test, np.ones(len(outputs), dtype=bool), 2, []), locate(train, campaign)
