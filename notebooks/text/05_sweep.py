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
# This notebook shows two tools. A sweep runs a study many times with different settings, such as the noise of the sensors.
# Sobol' indices show on which inputs and parameters the response depends.

# %%
import hsed_jax as hx

NOISE = [0.01, 0.1]  # standard deviation over the measured quantity
SEEDS = [0, 1, 2]

# %% [markdown]
# ## How much do better sensors help?
#
# Every study of this sweep calibrates the model with four experiments. The specimen has no effect that the model lacks. Each
# combination of noise and seed is one study and runs in its own process. Each seed gives another realisation of the noise.

# %%
study = hx.load_study(
    "../configs/paper.yaml",
    [
        "steps=[calibrate]",
        "design.initial=4",
        "experiments.virtual.effects={}",
        "error=null",  # use the noise that the laboratory declares
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
# The bars are 90 % intervals. With ten times the noise, they are about ten times as wide. The true values are A = 500 kN/m
# and β = 1. Every interval contains the true value or ends close to it.
#
# `swept.table` has one row per study. The file `runs/lesson_sweep/table.parquet` contains the same table. The next cell
# prints the means over the seeds:

# %%
swept.table.groupby("experiments.virtual.noise.relative")[["map.A", "sd.A", "map.beta", "sd.beta"]].mean()

# %% [markdown]
# If a study fails, the others continue. `swept.failures` then gives the reason. After a crash or Ctrl-C, the same call with
# `resume=True` runs the missing studies. With `scheduler="tcp://..."`, the sweep runs on a Dask cluster
# ([sweeps](../docs/sweeps.md)).
#
# ## Which inputs matter?
#
# The pulse of the ground motion has four numbers. The paper varies V_P and T_P. It fixes the number of oscillations γ = 2 and
# the phase ν = 0.1 rad, because the response hardly depends on them. The next cell checks this. Both become inputs with a
# small range around these values:


# %%
def pulse(gamma, nu):
    """The study of the paper, with all four numbers of the pulse as inputs."""
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
# The total-order index of a variable is the share of the variance that remains if all other variables are known. The period
# T_P has the largest index for all three quantities. V_P also matters for all of them. The stiffness A matters for the peak
# elongation and the dissipated energy. The indices of γ and ν are 0.02 or less, which agrees with the paper.
#
# The paper does not give the ranges of γ and ν. Recorded pulses can have any phase, and from 1.5 to 4 oscillations. The next
# cell uses these ranges:

# %%
wide = hx.sensitivity(pulse(gamma=[1.5, 4.0], nu=[0.0, 6.28]), samples=512)
wide.figure()

# %%
wide

# %% [markdown]
# The phase does not matter, even over the full circle. The number of oscillations matters most for the dissipated energy,
# because a longer pulse has more cycles. If your experiments measure the dissipated energy, make γ an input, too.
