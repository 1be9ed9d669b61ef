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
# # Many studies
#
# What would change if the sensors were worse, if the noise had fallen otherwise, if the ground had moved differently? Two tools
# answer: a sweep runs a study many times, and Sobol' indices tell which inputs and parameters the response depends on.

# %%
import hsed_jax as hx

NOISE = [0.01, 0.1]  # relative to the measured quantity
SEEDS = [0, 1, 2]

# %% [markdown]
# ## What do better sensors buy?
#
# Four experiments on a specimen that the model describes. Every combination of noise and seed is a study of its own, each in a
# process of its own; a seed is another draw of the noise.

# %%
study = hx.load_study(
    "../configs/paper.yaml",
    [
        "steps=[calibrate]",
        "design.initial=4",
        "experiments.virtual.effects={}",
        "error=null",  # the noise that the laboratory declares
        "calibration={chains: 1, warmup: 100, draws: 200, starts: 2}",
        "excitation.duration=4.0",
    ],
)
values = {"experiments.virtual.noise.relative": NOISE, "seed": SEEDS}
swept = hx.sweep(study, values, output="runs/lesson_sweep", force=True, progress=False)
swept

# %%
swept.figure()

# %% [markdown]
# Bars are 90 % intervals. With ten times the noise they are about ten times as wide, and the estimates scatter as much as the
# intervals say, around the true values A = 500 kN/m and β = 1.
#
# Everything is in one table, a row for each study, also in `runs/lesson_sweep/table.parquet`:

# %%
swept.table.groupby("experiments.virtual.noise.relative")[["map.A", "sd.A", "map.beta", "sd.beta"]].mean()

# %% [markdown]
# Where a study fails, the others go on; `swept.failures` has what was wrong. After a crash or Ctrl-C, the same call with
# `resume=True` runs what is missing. `scheduler="tcp://..."` runs it on a Dask cluster ([more](../docs/sweeps.md)).
#
# ## Which inputs matter?
#
# The paper varies V_P and T_P of the ground motion and fixes the other two numbers of the pulse, the number of oscillations γ = 2
# and the phase ν = 0.1, since the response hardly depends on them. Does it not? They become inputs, a tenth around their values:


# %%
def pulse(gamma, nu):
    """The paper's study with the whole pulse as inputs."""
    return hx.load_study(
        "../configs/paper.yaml",
        [
            "excitation.near_fault_pulse={V_P: V_P, T_P: T_P, gamma: gamma, nu: nu}",
            f"inputs.gamma={{uniform: {gamma}, unit: '1'}}",
            f"inputs.nu={{uniform: {nu}, unit: rad}}",
        ],
    )


near = hx.sensitivity(pulse(gamma=[1.8, 2.2], nu=[0.0, 0.2]), samples=512)
near.figure()

# %% [markdown]
# The total-order index of a variable is the share of the variance that would be left if everything else were known. The period
# and the velocity of the pulse and the stiffness A decide; γ and ν do not matter, as the paper says.
#
# But the paper does not say over which range. Recorded pulses have any phase, and from one and a half to four oscillations:

# %%
wide = hx.sensitivity(pulse(gamma=[1.5, 4.0], nu=[0.0, 6.28]), samples=512)
wide.figure()

# %%
wide

# %% [markdown]
# The phase does not matter over the whole circle. The number of oscillations does, for the dissipated energy most: a longer
# pulse makes more cycles. Who plans experiments on the energy would make γ an input, too.
