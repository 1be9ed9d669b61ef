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
# # Your structure, your test
#
# Two yielding storeys of different materials, a mass that is not known well, forces instead of an earthquake, a component test
# that is planned: all of it is written in the study, and none of it is programmed.

# %%
import tempfile
from pathlib import Path

import numpy as np

import hsed_jax as hx

FOLDER = Path(tempfile.mkdtemp())

# %% [markdown]
# ## Two specimens
#
# Each storey has a name, and may have a law of its own; what belongs to one has its name in front. The mass of the roof has a
# prior, so it is calibrated with the laws.

# %%
frame = hx.load_study("../configs/two_storeys.yaml")
frame

# %%
fit = hx.calibrate(frame)
fit

# %%
hx.compare(fit)

# %% [markdown]
# The model does not explain what was measured. In which storey does it fail?

# %%
hx.locate(fit)

# %% [markdown]
# The diagnosis fits every effect of the catalogue to either storey, and to the sensors of either.

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
better = hx.improve(fit, diagnosis)
better

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# A spring of the structure that was taken for linear is looked at, too: had the links been declared as a linear spring,
# `spring_1.yielding` would stand in that list.
#
# ## A force instead of an earthquake
#
# A shaker or a hammer pushes one mass. Its force is read from a file, and may be scaled by an input; `applied_force_1` is the
# channel that measures it.

# %%
time = np.arange(0.0, 2.0, 0.005)
push = 2.0e4 * np.sin(2 * np.pi * 1.5 * time) * np.exp(-time)
file = FOLDER / "push.csv"
np.savetxt(file, np.column_stack([time, push]), delimiter=",", header="t,F", comments="")
shaker = f"excitation={{applied_force: {{mass: 2, file: {file}, scale: s}}, duration: 4.0}}"
pushed = hx.load_study("../configs/two_storeys.yaml", [shaker, "inputs={s: {uniform: [1.0, 4.0]}}"])
hx.simulate(pushed, {"s": 3.0})

# %% [markdown]
# ## A planned component test
#
# Without a structure the specimen stands alone, and its elongation is imposed: cycles of growing amplitudes, the largest of which
# and their speed are inputs, so that a design chooses them.

# %%
test = hx.load_study("../configs/cyclic.yaml", ["steps=[design, calibrate]"])
hx.simulate(test, {"a": 40.0, "v": 50.0})

# %% [markdown]
# The design asks for the tests at which the model fails most, as it does with earthquakes; what is asked is told to the
# laboratory as a file of the elongation to impose.

# %%
run = hx.run(test, FOLDER / "cyclic", progress=False)
run.steps

# %% [markdown]
# What was seen: structures with several specimens, calibrated masses, forces and imposed cycles, from the study alone.
# [The settings](../docs/settings.md) have all keys.
