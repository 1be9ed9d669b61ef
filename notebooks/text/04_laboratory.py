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
# People and a controller prepare and run a test for a day, and sometimes it fails. How does the design wait for the test, and
# how does it treat a failed one?
#
# The design *asks*, and the laboratory *tells*. In between nothing runs, because everything is in the run folder. You can call
# each of the lines below on another day, here or with `hsed ask` and `hsed tell` in a terminal.

# %%
import shutil

import numpy as np
import pandas as pd

import hsed_jax as hx

RUN = "runs/lesson_laboratory"
shutil.rmtree(RUN, ignore_errors=True)  # the lesson begins anew each time

# %% [markdown]
# The study names the columns and units of the laboratory's records, and the limits of its actuator:

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
# Several tests may be pending at once. Until their results are told, the design uses its own prediction of them.

# %%
with hx.AskTell(study, RUN) as design:
    first, second = design.ask(2)
    print(design.told(first))

# %% [markdown]
# The folder of the request holds the ground motion for the controller, as a table and as `.AT2`, and the expected response for
# the operator. Before any measurement, the expected response follows from the prior alone. So its band is wide.

# %%
with hx.AskTell(output=RUN) as design:
    axes = hx.plot.expected(design, first.id)

# %% [markdown]
# ## Telling
#
# The laboratory of this notebook is a simulation with an effect that the model does not know; your laboratory has a hydraulic
# actuator. It returns a table with the columns that the study declares.

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
# The second test is done first. The first test fails half-way. Its partial record is kept with the reason for the failure, and
# it is not fitted.

# %%
with hx.AskTell(output=RUN) as design:
    design.tell(second.id, record=laboratory(second.inputs))
    design.failed(first.id, "the pump stopped", record=laboratory(first.inputs).head(120))
    print(design)

# %% [markdown]
# The design asks for it again. This time the table ran a little too strong. The design learns from the tested inputs, not from
# the requested ones.

# %%
with hx.AskTell(output=RUN) as design:
    again = design.ask_again(first.id)
    tested = again.inputs | {"V_P": 1.02 * again.inputs["V_P"]}
    design.tell(first.id, record=laboratory(tested), inputs=tested)

# %% [markdown]
# From now on it is a loop. After the initial experiments, each experiment is the one that is expected to tell most about the
# misfit.

# %%
with hx.AskTell(output=RUN) as design:
    while asked := design.ask():
        last = asked[0]
        design.tell(last.id, record=laboratory(last.inputs))
    axes = hx.plot.expected(design, last.id)
    print(design)

# %% [markdown]
# The figure compares the last experiment with its prediction. The band is narrow by now, and the specimen leaves it. More
# experiments of this kind would not help.
#
# ## Continue the run
#
# The run continues from the experiments in its folder, as if it had performed them itself:

# %%
run = hx.run(study, RUN, resume=True, progress=False)
run.comparison

# %% [markdown]
# The error is far above the noise, so the model lacks an effect. The notebook `03_hidden_effect` finds such an effect.
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
# `hsed tell` reads the record from the folder of the request, `record.csv` here. [Laboratories](../docs/laboratories.md)
# describes the other kinds: a program, a Python function, OpenSees.
