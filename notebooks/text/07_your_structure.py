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
# A study file describes structures and tests without programming. This notebook shows three cases:
#
# - a frame with two yielding storeys and a mass that is not well known,
# - the same frame under a force instead of an earthquake,
# - a component test that is planned.

# %%
import tempfile
from pathlib import Path

import numpy as np

import hsed_jax as hx

FOLDER = Path(tempfile.mkdtemp())

# %% [markdown]
# ## Two specimens
#
# Each storey has a name, and can have its own law. Here `storey1` has the Takeda law. `storey2` has the Bouc–Wen law of the
# study. The channels begin with the name of the storey. The parameters of a storey with its own law also begin with its name,
# such as `storey1.k`. The parameters of the law of the study, A and β, have no such prefix. The mass of the roof has a prior,
# so it is calibrated together with the laws.

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
# 82 % of the squared error is in the elongation of `storey2`. The diagnosis considers the effects of the catalogue in each
# storey, and in the sensors of each storey:

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
better = hx.improve(fit, diagnosis)
better

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The diagnosis names a loss of strength in `storey2`. With it, the held-out error falls to about the noise.
#
# The diagnosis also considers yielding of the linear springs of the structure. This frame has none. If the study declared the
# links of the second storey as a linear spring, `spring_1.yielding` would be a candidate.
#
# ## A force instead of an earthquake
#
# A shaker or a hammer loads one mass by a force. The study reads the force from a file, and an input can scale it. In a
# record, the channel `applied_force_2` is the force on mass 2.

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
# A study without a structure describes the specimen alone. The test imposes its elongation in cycles of growing amplitude.
# The largest amplitude `a` and the rate `v` are inputs, so a design can choose them.

# %%
test = hx.load_study("../configs/cyclic.yaml", ["steps=[design, calibrate]"])
hx.simulate(test, {"a": 40.0, "v": 50.0})

# %% [markdown]
# The design searches for the test with the largest discrepancy, as it does for earthquakes. `run.campaign` has all tests
# with their inputs, the initial design first. A real laboratory gets a file with the elongation to impose.

# %%
run = hx.run(test, FOLDER / "cyclic", progress=False)
run.campaign

# %% [markdown]
# `run.steps` has one entry per chosen test. Its `map` contains the estimates of the parameters (SI) before this test.

# %%
[step["map"] for step in run.steps]

# %% [markdown]
# A study file describes structures with several specimens, calibrated masses, applied forces and imposed cycles. [The
# settings](../docs/settings.md) list all keys.
