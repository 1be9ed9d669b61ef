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
# How do the results change with worse sensors, another draw of the noise, or another ground motion? Two tools answer this. A
# sweep runs a study many times. Sobol' indices show which inputs and parameters the response depends on.

# %%
import hsed_jax as hx

NOISE = [0.01, 0.1]  # relative to the measured quantity
SEEDS = [0, 1, 2]

# %% [markdown]
# ## How much do better sensors help?
#
# The sweep has four experiments on a specimen that the model describes. Every combination of noise and seed is a study of its
# own, in a process of its own. A seed is another draw of the noise.

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
# Bars are 90 % intervals. With ten times the noise they are about ten times as wide. The estimates scatter around the true
# values A = 500 kN/m and β = 1 as much as the intervals say.
#
# One table holds everything, with a row for each study. The file `runs/lesson_sweep/table.parquet` holds the same table:

# %%
swept.table.groupby("experiments.virtual.noise.relative")[["map.A", "sd.A", "map.beta", "sd.beta"]].mean()

# %% [markdown]
# If a study fails, the others continue, and `swept.failures` gives the reason. After a crash or Ctrl-C, the same call with
# `resume=True` runs the missing studies. `scheduler="tcp://..."` runs the sweep on a Dask cluster ([more](../docs/sweeps.md)).
#
# ## Which inputs matter?
#
# The paper varies V_P and T_P of the ground motion. It fixes the other two numbers of the pulse, the number of oscillations γ =
# 2 and the phase ν = 0.1, because the response hardly depends on them. To check this, both become inputs with a range of a
# tenth around these values:


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
# The total-order index of a variable is the share of the variance that remains if everything else is known. The period and the
# velocity of the pulse and the stiffness A have large indices. γ and ν do not matter, as the paper says.
#
# The paper does not give the range. Recorded pulses have any phase, and from one and a half to four oscillations:

# %%
wide = hx.sensitivity(pulse(gamma=[1.5, 4.0], nu=[0.0, 6.28]), samples=512)
wide.figure()

# %%
wide

# %% [markdown]
# The phase does not matter, even over the whole circle. The number of oscillations matters, and most for the dissipated energy:
# a longer pulse has more cycles. If you plan experiments on the energy, make γ an input, too.
