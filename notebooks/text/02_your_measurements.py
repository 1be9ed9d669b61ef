# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Your own measurements
#
# A laboratory shook one specimen four times and left a folder of spreadsheets in its own units. Is the plain Bouc–Wen law good
# enough for it?
#
# The laboratory is a few lines of NumPy here, so that the notebook runs anywhere. Put your own folder in its place.

# %%
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import hsed_jax as hx

MASS, STIFFNESS, STRENGTH, G = 2.0e4, 2.0e6, 5.0e4, 9.80665  # kg, N/m, N, m/s²
STIFFENING = 0.10  # of the stiffness: an elastic spring beside the element, which the model will not know


# %%
def shake(ground, dt, substeps=20):
    """Elongation [m], force [N] and absolute acceleration [m/s²] of one mass on the specimen, 2 % of critical damping."""
    u = v = z = 0.0
    h, c, rows = dt / substeps, 0.04 * np.sqrt(STIFFNESS * MASS), []
    for ag in ground:
        rows.append((u, z + STIFFENING * STIFFNESS * u, -(z + STIFFENING * STIFFNESS * u + c * v) / MASS))
        for _ in range(substeps):
            v += h * (-(z + STIFFENING * STIFFNESS * u + c * v) / MASS - ag)
            u += h * v
            z += h * (STIFFNESS * v - STIFFNESS / STRENGTH * abs(v) * z)
    return np.array(rows).T


# %% [markdown]
# ## The folder
#
# The folder holds one declaration, one table of experiments, and one spreadsheet per experiment ([the
# format](../docs/measurements.md)).

# %%
DECLARATION = """
name: frame 3 on the shake table
protocol: ground_motion
channels:
  time:                    {column: t, unit: s}
  ground_acceleration:     {column: ag, unit: g}
  elongation:              {column: du, unit: mm, noise: 0.5}
  force:                   {column: F, unit: kN, noise: 0.5}
  acceleration_1_absolute: {column: a, unit: g, noise: 0.005}
"""
EXPERIMENTS = "id,peak,split\nE01,0.15,train\nE02,0.25,train\nE03,0.35,train\nE04,0.30,test\n"


# %%
def record(number, peak, dt=0.02):
    """What the data logger of one experiment holds, in the units of the laboratory."""
    noise, t = np.random.default_rng(number), np.arange(0.0, 12.0, dt)
    ground = np.convolve(noise.standard_normal(t.size), np.hanning(15), "same") * (t / 3 * np.exp(1 - t / 3)) ** 2
    ground *= peak * G / np.abs(ground).max()
    du, force, a = shake(ground, dt)
    columns = {"t": t, "ag": ground / G, "du": 1e3 * du, "F": 1e-3 * force, "a": a / G}
    scatter = {"du": 0.5, "F": 0.5, "a": 0.005}
    return pd.DataFrame({k: x + scatter.get(k, 0.0) * noise.standard_normal(t.size) for k, x in columns.items()})


# %%
folder = Path(tempfile.mkdtemp()) / "frame_3"
(folder / "records").mkdir(parents=True)
(folder / "campaign.yaml").write_text(DECLARATION)
(folder / "experiments.csv").write_text(EXPERIMENTS)
records = {f"E{n:02d}": record(n, peak) for n, peak in enumerate([0.15, 0.25, 0.35, 0.30], start=1)}
exported = records["E02"].copy()
exported.loc[412:415, "F"] = np.nan  # the export lost four numbers
for name, table in (records | {"E02": exported}).items():
    table.to_csv(folder / "records" / f"{name}.csv", index=False, na_rep="nan")

# %%
campaign = hx.read_campaign(folder)
campaign

# %% [markdown]
# ## Are the data sound?

# %%
for finding in hx.check_campaign(campaign):
    print(finding)

# %% [markdown]
# The check names experiment, channel and time. An error stops a calibration, and nothing is repaired silently. The second
# export is complete:

# %%
records["E02"].to_csv(folder / "records" / "E02.csv", index=False)
campaign = hx.read_campaign(folder)
hx.check_campaign(campaign)

# %% [markdown]
# ## A study from the data
#
# `initial_study` (in a terminal: `hsed init`) drafts a study. In the file, a comment beside each number says where it comes
# from.

# %%
study = hx.initial_study(campaign, folder / "study.yaml")
text = (folder / "study.yaml").read_text()
print(text[text.index("structure:") : text.index("experiments:")].rstrip())

# %% [markdown]
# ## Calibrate

# %%
fit = hx.calibrate(study, campaign)
fit

# %% [markdown]
# ## How wrong is the model?

# %%
hx.compare(fit)

# %% [markdown]
# The model is not good enough. It predicts force and acceleration moderately well, and the elongation badly: a model with an
# error above one is worse than the mean of the measurement.

# %%
axes = hx.plot.histories(fit, "E04")

# %% [markdown]
# This experiment was never fitted. The model follows the force. It leaves a residual displacement that the specimen does not
# have.
#
# ## Where does it fail?

# %%
hx.locate(fit)

# %%
axes = hx.plot.where(fit)

# %% [markdown]
# It fails in the elongation, late in the test, and in the strongest motion: the error accumulates.

# %%
axes = hx.plot.loops(fit)

# %% [markdown]
# The measured loops return to the middle, and the predicted loops drift away. The specimen has a stiffness beyond yielding that
# the plain law lacks. `hx.diagnose(fit)` looks for the missing effect; the notebook *A model with a missing effect* continues
# from here. In a terminal, `hsed run study.yaml` does all of this.
