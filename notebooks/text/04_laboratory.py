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
# # Experiments that take days
#
# A test is prepared for a day, run by people and a controller, and sometimes fails. How does the design wait for it, and what
# does it make of a pump that stopped?
#
# The design *asks*, the laboratory *tells*. In between nothing runs: everything is in the run folder, and each of the lines below
# might be said on another day, by `hsed ask` and `hsed tell` in a terminal as well as here.

# %%
import shutil

import numpy as np
import pandas as pd

import hsed_jax as hx

RUN = "runs/lesson_laboratory"
shutil.rmtree(RUN, ignore_errors=True)  # the lesson begins anew each time

# %% [markdown]
# The study says what the laboratory hands over, by column and unit, and what its actuator can bear:

# %%
study = hx.load_study(
    "../configs/paper.yaml",
    [
        """experiments={folder: {channels: {time: {column: t, unit: s},
                                            elongation: {column: du, unit: mm, noise: {relative: 0.02}},
                                            force: {column: F, unit: kN, noise: {relative: 0.02}}}}}""",
        "observe=histories",
        "error=null",
        "steps=[design, calibrate, compare]",
        "excitation.duration=6.0",
        "design={initial: 3, iterations: 2, candidates: 1024, limits: {stroke: 0.8}}",
        "calibration={chains: 2, step_warmup: 50, step_draws: 50}",
    ],
)

# %% [markdown]
# ## Asking
#
# Several tests may be out at once; the design believes its own prediction of those until they are told.

# %%
with hx.AskTell(study, RUN) as design:
    first, second = design.ask(2)
    print(design.told(first))

# %% [markdown]
# The folder of the request holds the ground motion for the controller, as a table and as `.AT2`, and the response that the model
# expects, so that the operator sees what is coming: before any measurement from the prior alone, hence the wide band.

# %%
with hx.AskTell(output=RUN) as design:
    axes = hx.plot.expected(design, first.id)

# %% [markdown]
# ## Telling
#
# The laboratory of this lesson is a simulation with an effect that the model does not know; yours has a hydraulic jack. It
# returns a table with the columns that the study declares.

# %%
specimen = hx.load_study(
    "../configs/hidden_effect.yaml", ["model.effects={stiffness_degradation: {eta: 2.0e-5}}", "excitation.duration=6.0"]
)
noise = np.random.default_rng(0)


def laboratory(inputs):
    """What the sensors say: time [s], elongation [mm], force [kN]."""
    response = hx.simulate(specimen, inputs, {"A": 5.0e5, "beta": 1.0}, channels=("elongation", "force"))
    measured = {"du": 1e3 * response.channels["elongation"], "F": 1e-3 * response.channels["force"]}
    columns = {name: v + 0.02 * v.std() * noise.standard_normal(v.size) for name, v in measured.items()}
    return pd.DataFrame({"t": np.linspace(0.0, 6.0, len(measured["F"])), **columns})


# %% [markdown]
# The second test is done first; the first one fails half-way, and what was recorded until then is kept beside the reason, and
# not fitted.

# %%
with hx.AskTell(output=RUN) as design:
    design.tell(second.id, record=laboratory(second.inputs))
    design.failed(first.id, "the pump stopped", record=laboratory(first.inputs).head(120))
    print(design)

# %% [markdown]
# It is asked again. The table ran a little high this time: the design learns from the inputs that were tested, not from those
# it asked.

# %%
with hx.AskTell(output=RUN) as design:
    again = design.ask_again(first.id)
    tested = again.inputs | {"V_P": 1.02 * again.inputs["V_P"]}
    design.tell(first.id, record=laboratory(tested), inputs=tested)

# %% [markdown]
# From now on it is a loop. After the initial experiments each one is chosen where it is expected to tell most about the misfit.

# %%
with hx.AskTell(output=RUN) as design:
    while asked := design.ask():
        last = asked[0]
        design.tell(last.id, record=laboratory(last.inputs))
    axes = hx.plot.expected(design, last.id)
    print(design)

# %% [markdown]
# The last experiment against what was expected of it: the band is narrow by now, and the specimen leaves it. More experiments of
# the kind would not help.
#
# ## And then
#
# The run goes on from the experiments it has, as if it had performed them itself:

# %%
run = hx.run(study, RUN, resume=True, progress=False)
run.comparison

# %% [markdown]
# The error is far above the noise: the model lacks something. What that is, is the question of another lesson,
# `03_hidden_effect`.
#
# The same from a terminal:
#
# ```
# hsed ask study.yaml --count 2
# hsed tell runs/study E02
# hsed tell runs/study E01 --failed "the pump stopped"
# hsed ask runs/study --again E01
# hsed tell runs/study E01 --input V_P=2.295 --input T_P=1.0
# hsed run study.yaml --resume
# ```
#
# `hsed tell` reads what lies in the folder of the request, `record.csv` here. [Laboratories](../docs/laboratories.md) has the
# other ways: a program, a Python function, OpenSees.
