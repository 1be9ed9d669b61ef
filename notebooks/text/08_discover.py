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
# # An effect that the catalogue does not contain
#
# A laboratory tested a spring alone. It imposed cycles of several amplitudes and measured the force. The spring moves in a
# guide with friction. The friction acts in both directions of motion and grows with the elongation. No effect of the
# catalogue describes this friction. Can `discover` learn it from the measurements?
#
# A few lines of NumPy replace the laboratory. The study does not contain the friction. You can change the function `guide`
# and run all cells again.

# %%
import tempfile
from pathlib import Path

import numpy as np

import hsed_jax as hx
from hsed_jax.measurements import Channel, Noise

STIFFNESS = 1.0e6  # N/m
TESTS = {"E1": (10, 20), "E2": (15, 30), "E3": (25, 40), "E4": (40, 20), "E5": (12, 35), "E6": (30, 38)}  # mm
HELD_OUT = ("E5", "E6")


def guide(u, direction):
    """Friction of the guide [N]: 15 kN at 40 mm."""
    return 1.5e4 * (u / 0.04) ** 2 * direction


# %%
def record(name):
    """The record of one test in s, mm and kN: two cycles of 2 s at each of its two amplitudes."""
    time = np.arange(0.0, 8.0, 0.04)
    amplitude = 1e-3 * np.repeat(TESTS[name], 100)
    u, direction = amplitude * np.sin(np.pi * time), np.sign(np.cos(np.pi * time))
    noise = np.random.default_rng(int(name[1])).normal(0.0, 500.0, time.size)
    force = STIFFNESS * u + guide(u, direction) + noise
    return {"time": time, "elongation": 1e3 * u, "force": 1e-3 * force}


# %%
channels = {"time": "s", "elongation": "mm", "force": Channel("force", "kN", noise=Noise(absolute=500.0))}  # noise in N
campaign = hx.Campaign.from_frames(
    {"id": list(TESTS), "split": ["test" if name in HELD_OUT else "train" for name in TESTS]},
    {name: record(name) for name in TESTS},
    name="a spring in a guide",
    protocol="displacement",
    channels=channels,
)
folder = Path(tempfile.mkdtemp())
hx.write_campaign(campaign, folder / "campaign")
study = hx.Study(
    study="guide",
    model={"spring": "elastic", "parameters": {"k": {"uniform": [2e5, 5e6]}}},
    experiments={"campaign": str(folder / "campaign")},
    observe="histories",
    calibration={"sampler": "laplace"},
)

# %% [markdown]
# ## How wrong is the model?

# %%
fit = hx.calibrate(study, campaign)
hx.compare(fit)

# %%
axes = hx.plot.loops(fit)

# %% [markdown]
# The measured loop is widest at the ends of the stroke. The elastic model has no loop: its curve is a straight line.
#
# ## What does the diagnosis find?

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %% [markdown]
# The verdict is `ambiguous`: a viscous damping that grows with the elongation and a friction that falls with the speed lower
# the held-out error from 0.270 to 0.145 only, and other effects explain the data about as well. The rest is far above the
# noise. The catalogue has no formula for a friction that grows with the elongation, so these effects only approximate it.
# ## The discovery

# %%
discovery = hx.discover(fit, diagnosis=diagnosis)
discovery

# %%
ax = hx.plot.learned(discovery, campaign)

# %% [markdown]
# The discovery learns a force that depends on the elongation and the direction of motion. This is a friction that depends on
# the position. The law needs no other effect: with this force, it predicts the held-out tests down to the noise.
#
# The thick lines are the learned curves before a formula is fitted. The dashed lines are the formula: a force proportional to
# $u^2$ that acts against the motion. It is 15 kN at 40 mm, like the friction of the guide. The bands widen with the
# elongation, because a force proportional to the elongation can also belong to the spring. Such a force shifts both curves
# equally. It does not change the distance between them.

# %%
file = folder / discovery.file
discovery.write(file)
print(file.read_text())

# %% [markdown]
# The result is a Python file with an effect of your own. You can read it and change it. For example, give the effect a name
# that describes it, and a prior that excludes negative friction. A study names the file in `model: {own_effects: [...]}`.
#
# ## How much does the error fall?

# %%
effects = [*discovery.effects, discovery.effect]
better = hx.improve(fit, effects=effects, forms=discovery.forms, own_effects=[file])
better

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The error falls to the noise, also on the held-out tests. This is valid within the tested range. Beyond 40 mm, the friction
# of the model keeps its value at 40 mm. Only a test with larger elongations can show the true friction there.
#
# An error can also be lowered without a formula. `learn_remainder` learns what a model leaves of the force as a function of the
# path of the elongation, the *remainder*. Here it is that of the spring without its guide:

# %%
hx.learn_remainder(fit)

# %% [markdown]
# The remainder predicts the held-out tests as well, because their cycles resemble the fitted ones. It is no effect: it has no
# formula, and it belongs to this model of this specimen under imposed cycles. The learned effect can be used in another model.
#
# In a terminal, `hsed discover study.yaml` performs all these steps. [The page on discovery](../docs/discovery.md) describes
# how a place is chosen, and the limits of the method.
