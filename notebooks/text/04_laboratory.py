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
# In a real laboratory, one test can take a day, and a test can fail. How does a design wait for its tests? How does it treat
# a failed test?
#
# Two calls connect the design and the laboratory: `ask` requests an experiment, and `tell` reports its result. No program
# runs between the two calls, because the run folder stores everything. You can make each call on another day, here or in a
# terminal (`hsed ask` and `hsed tell`).

# %%
import shutil

import numpy as np
import pandas as pd

import hsed_jax as hx

RUN = "runs/lesson_laboratory"
shutil.rmtree(RUN, ignore_errors=True)  # delete the results of an earlier execution

# %% [markdown]
# The study declares the columns and units of the records, and the limits of the actuator:

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
# ## Ask for experiments
#
# Several experiments can be pending at the same time. Until their results are known, the design uses its predictions of them.

# %%
with hx.AskTell(study, RUN) as design:
    first, second = design.ask(2)
    print(design.told(first))

# %% [markdown]
# The folder of the request contains the ground motion for the controller, as a table and in the format `.AT2`. It also
# contains the expected response for the operator. Before the first measurement, the expected response depends only on the
# prior, so its band is wide.

# %%
with hx.AskTell(output=RUN) as design:
    axes = hx.plot.expected(design, first.id)

# %% [markdown]
# ## Tell the results
#
# In this notebook, a simulation replaces the laboratory. Its specimen has an effect that the model does not have. A real
# laboratory has an actuator instead. The laboratory returns a table with the columns that the study declares.

# %%
specimen = hx.load_study(
    "../configs/hidden_effect.yaml", ["model.effects={stiffness_degradation: {eta: 2.0e-5}}", "excitation.duration=6.0"]
)
noise = np.random.default_rng(0)


def laboratory(inputs):
    """Measured time [s], elongation [mm] and force [kN]."""
    response = hx.simulate(specimen, inputs, {"A": 5.0e5, "beta": 1.0}, channels=("elongation", "force"))
    measured = {"du": 1e3 * response.channels["elongation"], "F": 1e-3 * response.channels["force"]}
    columns = {name: v + 0.02 * v.std() * noise.standard_normal(v.size) for name, v in measured.items()}
    return pd.DataFrame({"t": np.linspace(0.0, 6.0, len(measured["F"])), **columns})


# %% [markdown]
# The second test is finished first. The first test fails before its end. The design keeps its partial record and the reason
# for the failure. This record is not fitted.

# %%
with hx.AskTell(output=RUN) as design:
    design.tell(second.id, record=laboratory(second.inputs))
    design.failed(first.id, "the pump stopped", record=laboratory(first.inputs).head(120))
    print(design)

# %% [markdown]
# `ask_again` requests the failed experiment again. This time, the ground motion is 2 % stronger than requested. The
# laboratory tells the tested inputs, and the design uses these instead of the requested ones.

# %%
with hx.AskTell(output=RUN) as design:
    again = design.ask_again(first.id)
    tested = again.inputs | {"V_P": 1.02 * again.inputs["V_P"]}
    design.tell(first.id, record=laboratory(tested), inputs=tested)

# %% [markdown]
# The other experiments follow in a loop. After the three initial experiments, the design asks for the experiment with the
# largest expected improvement:

# %%
with hx.AskTell(output=RUN) as design:
    while asked := design.ask():
        last = asked[0]
        design.tell(last.id, record=laboratory(last.inputs))
    axes = hx.plot.expected(design, last.id)
    print(design)

# %% [markdown]
# The figure compares the last experiment with its prediction. The band is now so narrow that it is hardly visible, and the
# measurement leaves it. More experiments of this kind do not remove this difference.
#
# ## Continue the run
#
# The run takes the experiments from its folder and continues with the next steps of the study:

# %%
run = hx.run(study, RUN, resume=True, progress=False)
run.comparison

# %% [markdown]
# The error is about twelve times the noise, so the model lacks an effect. The notebook *A model with a missing effect*
# (`03_hidden_effect`) shows how to find it.
#
# These are the same steps in a terminal:
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
# `hsed tell` reads the file `record.csv` in the folder of the request. [Laboratories](../docs/laboratories.md) describes the
# other kinds of laboratory: a program, a Python function, OpenSees.
