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
# # From a CSV file to a named effect
#
# A column was pushed and pulled in growing cycles. The laboratory left one file. Which effect does the plain Bouc–Wen law lack?
#
# The first cell is the laboratory, a few lines of NumPy that share no code with the package. The strength of its column falls
# with the absorbed energy. Put the name of your own file in the second cell.

# %%
from pathlib import Path

import numpy as np
import pandas as pd

import hsed_jax as hx

drift = np.concatenate([a * np.sin(np.linspace(0, 2 * np.pi, 121)[1:]) for a in (6, 12, 18, 24, 30, 36)])  # mm
stiffness, strength, loss = 12.0, 80.0, 1.2e-4  # kN/mm, kN, 1/(kN mm)
force, energy, row = 0.0, 0.0, []
for step in np.diff(drift, prepend=0.0):
    for part in np.full(50, step / 50):
        force += stiffness * (part - (1 + loss * energy) * abs(part) * force / strength)
        energy += force * part
    row.append(force)
noisy = np.array(row) + np.random.default_rng(1).normal(0, 0.8, drift.size)
Path("runs").mkdir(exist_ok=True)
pd.DataFrame({"drift (mm)": drift, "force (kN)": noisy}).round(3).to_csv("runs/column.csv", index=False)

# %% [markdown]
# The names of the columns and their units tell what was measured. The last third of the test is held out: it is predicted, and
# never fitted.

# %%
campaign = hx.read_files("runs/column.csv")
campaign

# %%
study = hx.initial_study(campaign)  # priors around the stiffness and strength that the record shows
fit = hx.calibrate(study, campaign)
hx.compare(fit)

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %% [markdown]
# The law fits the early cycles fairly well and predicts the later ones badly. The diagnosis names an effect out of the whole
# catalogue. Add it, and calibrate again:

# %%
better = hx.improve(fit, diagnosis)
better

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The improved law follows the cycles that were not fitted. In a terminal, `hsed run FILE` does all of this and writes a report.
