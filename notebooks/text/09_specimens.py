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
# A laboratory tested six dampers of the same type. Every damper had the same two tests. The strengths of the dampers differ,
# and one damper has an effect that the others do not have. Is a difference between two specimens only scatter, or does it
# have a physical cause?
#
# A few lines of NumPy replace the laboratory, so the notebook runs on any computer.

# %%
import numpy as np
import pandas as pd

import hsed_jax as hx

STRENGTH, SCATTER, YIELD = 4.0e4, 0.08, 5.0e-3  # N, standard deviation of ln(strength), m
DASHPOT = 4.0e4  # N s/m, only in the last specimen
RANDOM = np.random.default_rng(1)


# %%
def test(strength, dashpot, frequency, amplitude, noise=800.0):
    """One cyclic test of a yielding spring with a parallel dashpot; the measured force has noise."""
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
# The column `specimen` gives the damper of each test. `model.levels` declares the parameters that vary from damper to damper.
# Here this is the stiffness A, and with it the strength $A/\beta$. The parameter β is the same for all dampers. Both tests of
# the fifth damper, D4, are held out, so the calibration does not know its stiffness.

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
# `specimen.A.spread` is the standard deviation of ln A in the population. The rows below it give A of each specimen. This
# model has no dashpot. For D5, it represents the dashpot by a larger stiffness.

# %%
axes = hx.plot.population(fit)

# %% [markdown]
# The model predicts D4 from the population. The width of the grey band includes the scatter of the specimens.

# %%
hx.compare(fit)

# %% [markdown]
# The diagnosis searches for missing effects. For an effect that it finds, it states which specimens have it: all, some or
# none.

# %%
diagnosis = hx.diagnose(fit, campaign)
diagnosis

# %%
for found in diagnosis.specimens:
    print(found.sentence)
    print(pd.DataFrame(found.of).T)

# %% [markdown]
# The verdict is `unexplained`, because no effect improves the prediction of all dampers. The diagnosis then examines single
# dampers. It finds `viscous_damping` in D5, with a probability of 1.00. This effect is a damping force that grows with the
# rate, like the force of the dashpot of the laboratory. The other dampers do not have it. The prediction of the next damper
# therefore leaves it out.
