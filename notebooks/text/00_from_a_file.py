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
# A laboratory imposed growing cycles on a column and saved one CSV file. This notebook fits a Bouc–Wen law to the file and
# finds the effect that the law lacks.
#
# The first code cell replaces the laboratory. It writes the file with a few lines of NumPy and does not use the package. The
# strength of this column falls with the absorbed energy. The package does not know this: it reads only the displacement and
# the force. To analyse your own file, write its name in the second code cell.

# %%
from pathlib import Path

import numpy as np
import pandas as pd

import hsed_jax as hx

drift = np.concatenate([a * np.sin(np.linspace(0, 2 * np.pi, 121)[1:]) for a in (6, 12, 18, 24, 30, 36)])  # mm
stiffness, strength, loss = 12.0, 80.0, 1.2e-4  # kN/mm, kN, 1/(kN mm)
force, energy, row = 0.0, 0.0, []
for step in np.diff(drift, prepend=0.0):
    for part in np.full(50, step / 50):  # small steps of the integration
        force += stiffness * (part - (1 + loss * energy) * abs(part) * force / strength)  # Bouc-Wen law
        energy += force * part  # absorbed energy [kN mm]
    row.append(force)
noisy = np.array(row) + np.random.default_rng(1).normal(0, 0.8, drift.size)  # noise [kN]
Path("runs").mkdir(exist_ok=True)
pd.DataFrame({"drift (mm)": drift, "force (kN)": noisy}).round(3).to_csv("runs/column.csv", index=False)

# %% [markdown]
# **Read.** The names of the columns contain the quantity and the unit, so `read_files` recognises the imposed displacement
# and the force. The package calls the displacement of the specimen its *elongation*. The two rows of the table below belong
# to the same record. The experiment `column` is the first two thirds of it, which are fitted (`train`). The experiment
# `column_end` is the last third, which is held out (`test`): the model predicts it, but is never fitted to it.
#
# **Calibrate and compare.** `calibrate` fits the plain Bouc–Wen law. `compare` prints its error: 0 means a perfect model, and
# 1 means a model that is only as good as the mean of the measurement. The column `noise` is the error of the noise alone.
#
# **Diagnose.** `diagnose` searches the catalogue for the effect that the law lacks.

# %%
campaign = hx.read_files("runs/column.csv")
campaign

# %%
study = hx.initial_study(campaign)  # its priors are centred on values read from the record
fit = hx.calibrate(study, campaign)
hx.compare(fit)

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %% [markdown]
# **Error.** On the fitted cycles, the error of the plain law is about nine times the noise. On the held-out cycles, it is
# about 25 times the noise. The plain law is not good enough.
#
# **Effect.** The diagnosis names `strength_degradation`: the strength falls during the test, in proportion to the absorbed
# energy. With this effect, the held-out error falls to twice the noise.
#
# **Behaviour.** The line *what the model with them does* describes the specimen before and after the test. The package
# simulates cycles at half of the largest elongation, here 18 mm. Strength is the force at the end of such a cycle: it falls
# from 54.8 to 24.8 kN. Recentring is 1 if the specimen returns to zero when the force is removed, and 0 if it keeps the whole
# elongation. It falls, too. The initial stiffness changes by less than 5 %.
#
# The next cell adds the effect to the law and calibrates again:

# %%
better = hx.improve(fit, diagnosis)
better

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The held-out error falls from 0.685 to 0.030. In the figure, the improved law (blue) follows the held-out cycles (grey
# area). The result is: *the strength of the column falls with the absorbed energy*. This is the effect in the first code cell.
#
# In a terminal, `hsed run FILE` performs all these steps and writes a report.
