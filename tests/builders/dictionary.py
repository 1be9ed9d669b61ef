"""A dictionary of known functions: law + sum of amplitude × function, so that every answer is known in closed form."""

import math

import numpy as np

from hsed_jax.diagnosis.batch import Batch
from hsed_jax.diagnosis.box import Box
from hsed_jax.diagnosis.measured import Measured
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import FormColumns, Problem
from hsed_jax.diagnosis.search import Search
from hsed_jax.inference.likelihood import Error
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.effects import EFFECTS as CATALOGUE
from hsed_jax.physics.effects.base import Form
from hsed_jax.physics.scales import Scales

N, J, K, SIGMA = 6, 40, 8, 0.5
RANDOM = np.random.default_rng(11)
# White, so that nothing is like anything else: (2 + K, N, J).
FUNCTIONS = RANDOM.standard_normal((2 + K, N, J))
COLUMNS = {f"effect_{k}": np.array([2 + k]) for k in range(K)}
EFFECTS = {name: {"": FormColumns(Form(is_default=True), columns, {})} for name, columns in COLUMNS.items()}
LAW = np.arange(2)


class Dictionary(Batch):
    """Outputs are linear in θ."""

    def __init__(self, functions, fails=False):
        self.functions, self.fails = functions, fails

    def __call__(self, thetas, experiments, samples=None):
        outputs = np.einsum("lk,klj->lj", thetas, self.functions[:, experiments])
        # Where asked for, beyond the experiments that are fitted nothing converges with an effect.
        failed = self.fails & (np.asarray(experiments) >= N) & np.any(thetas[:, 2:] != 0, axis=1)
        return outputs * ~failed[:, None], 1.0 - failed


PRIORS = {"a": Prior("normal", [0.0, 3.0]), "b": Prior("normal", [0.0, 3.0])} | {
    name: Prior("normal", [0.0, 1.0]) for name in EFFECTS
}
BOX = Box(PRIORS)


def measured_of(values, used=None, declared=SIGMA):
    used = np.ones(values.shape, dtype=bool) if used is None else used
    noise = 0.0 if math.isnan(declared) else declared / float(np.std(values[used]))
    groups = np.zeros(values.shape[1], dtype=int)
    error = Error(Prior("half_normal", 1.0) if math.isnan(declared) else declared, correlated=False)
    return Measured(values, used, np.full(values.shape, np.inf), groups, (error,), noise)


def search_of(values, is_explained=lambda fit: False, functions=FUNCTIONS, batch=Dictionary, **more):
    models = NestedModels(batch(functions), BOX, np.zeros(2 + K))
    search = Search(models, measured_of(values, **more), LAW, EFFECTS, is_explained)
    search.start()
    return search


def found_in(values, **more):
    search = search_of(values, **more)
    search.run()
    return search


def data_of(seed, **amplitudes):
    theta = np.zeros(2 + K)
    theta[:2] = 1.5, -0.7
    for name, value in amplitudes.items():
        theta[COLUMNS[name]] = value
    noise = SIGMA * np.random.default_rng(seed).standard_normal((N, J))
    return np.einsum("k,knj->nj", theta, FUNCTIONS) + noise


def rivals_problem(functions, values):
    """A problem on the dictionary whose last experiments were not made."""
    count = functions.shape[1] - len(values)
    return Problem(
        models=NestedModels(Dictionary(functions), BOX, np.zeros(2 + K)),
        names=tuple(PRIORS),
        units={},
        law=LAW,
        effects=EFFECTS,
        catalogue=CATALOGUE.only(()),
        scales=Scales(),
        train=measured_of(values),
        test=None,
        experiments=(),
        outputs=("y",),
        candidates=[{"number": float(k)} for k in range(count)],
        seed=0,
    )
