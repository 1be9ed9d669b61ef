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
# # An effect that the catalogue does not hold
#
# A spring was tested alone: cycles of several elongations were imposed, and its force was measured. The spring runs in a guide
# that jams: its friction grows with the elongation, in both directions of the motion. No effect of the catalogue describes
# this. Does the discovery find it?
#
# The laboratory is a few lines of NumPy, so the study cannot know the effect. Change the friction of the guide, and run
# everything again.

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
    """Friction of the guide [N], 15 kN at 40 mm."""
    return 1.5e4 * (u / 0.04) ** 2 * direction


# %%
def record(name):
    """What the data logger of one test holds: two cycles of 2 s at each amplitude, [s], [mm], [kN]."""
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
# The measured loop is widest at the ends of the stroke. The loop of the model is not.
#
# ## What does the catalogue give?

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %% [markdown]
# The diagnosis takes several effects that each explain a part of the misfit. It cannot decide between them, and the remaining
# misfit is far above the noise. The catalogue has no formula of this friction, so the diagnosis spreads it over other dampers
# and frictions.
#
# ## The discovery

# %%
discovery = hx.discover(fit, diagnosis=diagnosis)
discovery

# %%
ax = hx.plot.learned(discovery, campaign)

# %% [markdown]
# The result is a force that depends on elongation and direction: a friction that depends on the position. With the law alone,
# it predicts the held-out tests down to the noise, so none of the effects above is needed.
#
# The thick lines are the learned curves, before any formula is fitted. The dashed lines are the formula, $u^2$ against the
# motion: 15 kN at 40 mm, which is the value of the guide. The bands widen with the elongation, because a force in proportion to
# the elongation may also belong to the spring. Such a force moves both lines alike, and does not change the distance between
# them.

# %%
file = folder / discovery.file
discovery.write(file)
print(file.read_text())

# %% [markdown]
# The result is a file with an effect of your own. You can read and change it: give it a name that describes it, and a prior
# that excludes negative friction. A study names the file in `model: {own_effects: [...]}`.
#
# ## How much does the error fall?

# %%
effects = [*discovery.effects, discovery.effect]
better = hx.improve(fit, effects=effects, forms=discovery.forms, own_effects=[file])
better

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The error falls to the noise, also on the held-out tests. This holds within the tested range. Beyond 40 mm the friction keeps
# its value at 40 mm; only a test can show the true value.
#
# In a terminal, `hsed discover study.yaml` does all of this. [The page on discovery](../docs/discovery.md) describes how a
# place is chosen, and the limits of the method.
