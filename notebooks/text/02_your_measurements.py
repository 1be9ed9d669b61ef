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
# A laboratory tested one specimen four times on a shake table. It saved a folder of CSV files in its own units. Is the plain
# Bouc–Wen law good enough for this specimen? If not, where does it fail?
#
# A few lines of NumPy replace the laboratory, so the notebook runs on any computer. For your own tests, use your own folder
# instead.

# %%
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import hsed_jax as hx

MASS, STIFFNESS, STRENGTH, G = 2.0e4, 2.0e6, 5.0e4, 9.80665  # kg, N/m, N, m/s²
STIFFENING = 0.10  # stiffness of a parallel elastic spring over STIFFNESS; the model does not have this spring


# %%
def shake(ground, dt, substeps=20):
    """Elongation [m], force [N] and absolute acceleration [m/s²] of one mass on the specimen; the damping is 2 %."""
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
# The folder contains a declaration, a table of experiments, and one CSV file per experiment
# ([format](../docs/measurements.md)).

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
    """The record of one experiment in the units of the laboratory."""
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
exported.loc[412:415, "F"] = np.nan  # four numbers are missing in this export
for name, table in (records | {"E02": exported}).items():
    table.to_csv(folder / "records" / f"{name}.csv", index=False, na_rep="nan")

# %%
campaign = hx.read_campaign(folder)
campaign

# %% [markdown]
# ## Check the data

# %%
for finding in hx.check_campaign(campaign):
    print(finding)

# %% [markdown]
# The check names the experiment, the channel and the time of the error. An error stops the calibration. The package does not
# repair data silently. The second export of the file is complete:

# %%
records["E02"].to_csv(folder / "records" / "E02.csv", index=False)
campaign = hx.read_campaign(folder)
hx.check_campaign(campaign)

# %% [markdown]
# ## Draft a study
#
# `initial_study` writes a first study for the campaign. In a terminal, `hsed init` does the same. The comments in the file
# give the source of the numbers.

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
# The model is not good enough. On the held-out test E04, the error of the elongation is 2.6. A model with an error above 1 is
# worse than the mean of the measurement. The errors of force and acceleration are about 0.1, which is about two to three
# times the noise.

# %%
axes = hx.plot.histories(fit, "E04")

# %% [markdown]
# The model was not fitted to this experiment. The predicted force follows the measured force. The predicted elongation does
# not follow the measured one: it ends near −75 mm, and the specimen ends near −15 mm.
#
# ## Where does it fail?

# %%
hx.locate(fit)

# %%
axes = hx.plot.where(fit)

# %% [markdown]
# 99 % of the squared error is in the elongation, and 96 % occurs after 4.78 s. 86 % is in E03, which has the strongest ground
# motion. The error grows during the test.

# %%
axes = hx.plot.loops(fit)

# %% [markdown]
# The predicted loops drift away from zero elongation. The measured loops drift much less. The specimen keeps a stiffness
# after yielding, and the plain law does not have this stiffness. `hx.diagnose(fit)` searches for the missing effect. The
# notebook *A model with a missing effect* shows this step. In a terminal, `hsed run study.yaml` performs all steps.
