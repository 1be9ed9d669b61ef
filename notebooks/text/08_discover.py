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
# # What no catalogue holds
#
# A spring was tested alone: cycles of several elongations were imposed, and its force was measured. The guide that it runs in
# jams: it rubs the more the further the spring is out, whichever way it moves. No effect of the catalogue does that. Is it found?
#
# The laboratory is a few lines of NumPy, so the study cannot know. Change the friction of the guide, and run everything again.

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
# What was measured has a loop that is widest at the ends of the stroke. The model has none.
#
# ## What does the catalogue say?

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %% [markdown]
# It takes several effects that each stand for a part of it, cannot tell which, and what they leave is still far above the noise.
# A friction that no formula of the catalogue is has been spread over dampers and frictions that it is not.
#
# ## What is it, then?

# %%
discovery = hx.discover(fit, diagnosis=diagnosis)
discovery

# %%
ax = hx.plot.learned(discovery, campaign)

# %% [markdown]
# A force that depends on elongation and direction: a friction of the position. Beside the law alone it predicts the tests that
# were held out to the noise, so none of the effects above is needed.
#
# The thick lines are the curves before anybody thought of a formula, the dashed ones the formula, $u^2$ against the motion: 15 kN
# at 40 mm, as the guide has it. The bands widen with the elongation for a force in proportion to it might as well belong to
# the spring; it would move both lines alike, and not the distance between them.

# %%
file = folder / discovery.file
discovery.write(file)
print(file.read_text())

# %% [markdown]
# An effect of your own, to be read and changed: a name that says what it is, a prior that knows that friction is not negative. A
# study names the file in `model: {own_effects: [...]}`.
#
# ## What does adding it do?

# %%
effects = [*discovery.effects, discovery.effect]
better = hx.improve(fit, effects=effects, forms=discovery.forms, own_effects=[file])
better

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The error falls to the noise, on the tests that were held out as well. Within what was tested, that is: beyond 40 mm the
# friction is held at its value there, and only a test can say what it does.
#
# In a terminal all of this is `hsed discover study.yaml`; [the page on discovery](../docs/discovery.md) says how a place is
# chosen, and what cannot be told.
