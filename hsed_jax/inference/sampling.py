"""Draws of a posterior by the sampler that a study asks for (`hsed_jax.inference.samplers`).

No sampler crosses from one mode of a posterior to another.  Each mode is therefore sampled alone, in its own frame, and the
draws are mixed by the shares of the modes in the posterior.
"""

import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.independent import generator
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.nuts import Chains, Settings, convergence
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.samplers import SAMPLERS
from hsed_jax.inference.watch import Watch

# Fields of `Chains` that are arrays.
_ARRAYS = 5


def draw(
    posterior: Posterior,
    data: Data,
    maximum: Maximum,
    step_size: Float[Array, ""],
    key: PRNGKeyArray,
    settings: Settings,
    watch: Watch | None = None,
    seconds: float | None = None,
) -> Chains:
    """Draws of the posterior (chains, draws, p).

    Arguments:
        posterior: of the study.
        data: measured outputs.
        maximum: the modes and the whitening there (`maximise`).
        step_size: of NUTS, to begin adaptation from.
        key: of the random numbers.
        settings: sizes, and by which sampler.
        watch: follows NUTS.
        seconds: budget of NUTS; `doubt` lists the omitted steps.
    """
    asked = Requested(posterior, data, maximum, step_size, key, settings, watch or Watch(), seconds)
    if not maximum.others:
        return SAMPLERS[settings.sampler].draw(asked)
    of_order, *keys = jax.random.split(key, 1 + len(maximum.modes))
    asked = asked._replace(seconds=seconds and seconds / len(keys))
    found = [
        SAMPLERS[settings.sampler].draw(asked._replace(maximum=mode, key=of_mode))
        for mode, of_mode in zip(maximum.modes, keys, strict=True)
    ]
    return _mixed(found, maximum.shares, of_order)


def _mixed(found: list[Chains], shares: Float[np.ndarray, " modes"], key: PRNGKeyArray) -> Chains:
    """Chains that hold draws of every mode in proportion to its share, in random order.

    A chain takes its draws from the chains of the same number and in their order, so that one that has not converged in its mode
    still differs from the others.
    """
    # Under a time budget some chains have fewer draws.
    chains, draws = found[0].theta.shape[0], min(c.theta.shape[1] for c in found)
    ends = np.round(np.cumsum(shares) * draws).astype(int)
    counts = np.diff(ends, prepend=0)
    random = generator(key)
    chosen = np.empty((chains, draws), dtype=int)
    for chain in chosen:
        mode = random.permutation(np.repeat(np.arange(len(found)), counts))
        for k, count in enumerate(counts):
            chain[mode == k] = k * draws + np.sort(random.choice(draws, count, replace=False))
    arrays = jax.device_put(
        [
            np.concatenate([np.asarray(leaf)[:, :draws] for leaf in leaves], axis=1)[np.arange(chains)[:, None], chosen]
            for leaves in zip(*(c[: _ARRAYS - 1] for c in found), strict=True)
        ]
    )
    # Mixing hides the correlation of draws within a mode, so their effective number stays as before.
    worths = [min(chains * count, convergence(c).ess_bulk.min()) for c, count in zip(found, counts, strict=True)]
    errors = [c.emulator_error for c in found if c.emulator_error is not None]
    return Chains(
        *arrays,
        step_size=found[0].step_size,
        sampler="nuts" if any(c.sampler == "nuts" for c in found) else found[0].sampler,
        worth=float(1 / sum(share**2 / max(worth, 1.0) for share, worth in zip(shares, worths, strict=True))),
        emulator_error=max(errors) if len(errors) == len(found) else None,
        doubt="; ".join(dict.fromkeys(c.doubt for c in found if c.doubt)) or None,
    )
