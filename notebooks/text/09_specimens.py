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
# # Many specimens
#
# Six dampers of one make were tested in the same two ways. Their strengths differ, and one has an effect that the others do not
# have. Is a difference between two specimens scatter, or physics?
#
# The laboratory is a few lines of NumPy here, so that the notebook runs anywhere.

# %%
import numpy as np
import pandas as pd

import hsed_jax as hx

STRENGTH, SCATTER, YIELD = 4.0e4, 0.08, 5.0e-3  # N, of its logarithm, m
DASHPOT = 4.0e4  # N s/m, in the last specimen alone
RANDOM = np.random.default_rng(1)


# %%
def test(strength, dashpot, frequency, amplitude, noise=800.0):
    """One cyclic test: a spring that yields, the dashpot beside it, and the noise of a load cell."""
    t = np.linspace(0.0, 4.0 / frequency, 160)
    u = amplitude * (0.3 + 0.7 * t / t[-1]) * np.sin(2 * np.pi * frequency * t)
    dense = np.linspace(0.0, t[-1], 40 * (t.size - 1) + 1)
    way = amplitude * (0.3 + 0.7 * dense / t[-1]) * np.sin(2 * np.pi * frequency * dense)
    z, force = 0.0, [0.0]
    for step in np.diff(way):
        limit = np.sign(step) * strength
        z = limit + (z - limit) * np.exp(-abs(step) / YIELD)
        force.append(z)
    total = np.array(force)[::40] + dashpot * np.gradient(u, t)
    return pd.DataFrame({"time": t, "elongation": u, "force": total + noise * RANDOM.standard_normal(t.size)})


# %%
strengths = STRENGTH * np.exp(SCATTER * RANDOM.standard_normal(6))
rows, records = [], {}
for number, strength in enumerate(strengths):
    for way, (frequency, amplitude) in enumerate([(0.4, 0.02), (1.0, 0.015)]):
        name = f"D{number}_{way}"
        records[name] = test(strength, DASHPOT if number == 5 else 0.0, frequency, amplitude)
        rows.append({"id": name, "specimen": f"D{number}", "split": "test" if number == 4 else "train"})
units = {"time": "s", "elongation": "m", "force": "N"}
campaign = hx.Campaign.from_frames(pd.DataFrame(rows), records, name="dampers", protocol="displacement", channels=units)

# %% [markdown]
# The column `specimen` names the damper of each test. `model.levels` says which parameters vary with it: the stiffness, and
# with it the strength $A/\beta$. The shape of the loop is the same for all. All tests of the fifth damper are held out, so its
# stiffness is unknown.

# %%
study = hx.load_study(
    {
        "study": "dampers",
        "model": {
            "parameters": {"A": {"lognormal": [16.0, 0.5]}, "beta": {"lognormal": [5.3, 0.5]}, "gamma": 0.0, "n": 1.0},
            "levels": {"specimen": ["A"]},
        },
        "experiments": {"campaign": "nowhere"},
        "observe": "histories",
        "error": {"absolute": 800.0},
        "steps": ["calibrate", "compare", "diagnose"],
    }
)
fit = hx.calibrate(study, campaign)
fit

# %% [markdown]
# `specimen.A.spread` is the standard deviation of the logarithms. The rows below it are the single specimens. For the last one,
# this model explains the dashpot by a larger stiffness.

# %%
axes = hx.plot.population(fit)

# %% [markdown]
# The unknown damper is predicted from the population: the width of its band is the scatter of the specimens.

# %%
hx.compare(fit)

# %% [markdown]
# The diagnosis looks for missing effects. For each named effect it decides whether the population has it, only these specimens,
# or none of them.

# %%
diagnosis = hx.diagnose(fit, campaign)
diagnosis

# %%
for found in diagnosis.specimens:
    print(found.sentence)
    print(pd.DataFrame(found.of).T)

# %% [markdown]
# One damper has the dashpot. It is no property of the make, and a model for the next damper does not have it.
