"""Posteriors of toys, their maximum and their draws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hsed_jax.inference.likelihood import Data, Error, data_of
from hsed_jax.inference.maximum import maximise
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.sampling import draw
from hsed_jax.physics.simulator import Conditions


def posterior_of(respond, priors, errors) -> Posterior:
    """The posterior of a toy: `respond` gives one output per error."""
    outputs = [f"y{j}" for j in range(len(errors))]
    return Posterior(Predictor(respond), priors, [Error(e) for e in errors], outputs, np.arange(len(errors)))


def measured_at(x, values) -> Data:
    """Measured outputs (n, J) at the inputs x (n,)."""
    values = np.asarray(values, float)
    conditions = Conditions({"x": jnp.asarray(x, float)})
    return data_of(conditions, values, np.isfinite(values), np.full(values.shape, np.inf), len(values))


def find(posterior, data, starts=4):
    return maximise(posterior, data, posterior.starts(starts))


def drawn(posterior, data, maximum, settings, seed=0, **more):
    return draw(posterior, data, maximum, jnp.asarray(0.8), jax.random.key(seed), settings, **more)


# A chain takes ten times as long as weighted draws.
EXACT = pytest.mark.parametrize("sampler", [pytest.param("nuts", marks=pytest.mark.whole), "importance"])
