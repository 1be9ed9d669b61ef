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
# The structure has two yielding storeys of different materials and a mass that is not well known. It is loaded by forces
# instead of an earthquake. A component test is planned. The study describes all of this, and nothing is programmed.

# %%
import tempfile
from pathlib import Path

import numpy as np

import hsed_jax as hx

FOLDER = Path(tempfile.mkdtemp())

# %% [markdown]
# ## Two specimens
#
# Each storey has a name, and may have a law of its own. The name of the storey stands before its parameters and channels. The
# mass of the roof has a prior, so it is calibrated with the laws.

# %%
frame = hx.load_study("../configs/two_storeys.yaml")
frame

# %%
fit = hx.calibrate(frame)
fit

# %%
hx.compare(fit)

# %% [markdown]
# The model does not explain the measurements. In which storey does it fail?

# %%
hx.locate(fit)

# %% [markdown]
# The diagnosis fits every effect of the catalogue to each storey, and to the sensors of each storey.

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
better = hx.improve(fit, diagnosis)
better

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The diagnosis also checks a linear spring of the structure. If the links were declared as a linear spring, `spring_1.yielding`
# would be in that list.
#
# ## A force instead of an earthquake
#
# A shaker or a hammer pushes one mass. Its force is read from a file, and an input may scale it. The channel `applied_force_1`
# measures it.

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
# Without a structure the specimen is alone, and its elongation is imposed in cycles of growing amplitudes. The largest
# amplitude and the rate are inputs, so a design chooses them.

# %%
test = hx.load_study("../configs/cyclic.yaml", ["steps=[design, calibrate]"])
hx.simulate(test, {"a": 40.0, "v": 50.0})

# %% [markdown]
# The design asks for the tests in which the model fails most, as with earthquakes. The laboratory gets a file with the
# elongation to impose.

# %%
run = hx.run(test, FOLDER / "cyclic", progress=False)
run.steps

# %% [markdown]
# The study alone described structures with several specimens, calibrated masses, forces and imposed cycles. [The
# settings](../docs/settings.md) list all keys.
