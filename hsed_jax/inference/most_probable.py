"""The most probable parameters, with the errors, the weights of the samples and the discrepancy that belong to them.

These follow from the residual, which depends weakly on them. They and the parameters are therefore computed alternately.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.correlation import NoiseEstimate, estimate_noise, size_p_value
from hsed_jax.inference.expansion import centred, expand
from hsed_jax.inference.likelihood import Data, Error
from hsed_jax.inference.maximum import Maximum, maximise
from hsed_jax.inference.posterior import Posterior, constrained, unconstrained
from hsed_jax.inference.watch import arrays_of, tree_like
from hsed_jax.programs import program

if TYPE_CHECKING:
    # A calibration without a discrepancy loads no Gaussian process.
    from hsed_jax.inference.discrepancy.base import AbstractDiscrepancy
    from hsed_jax.inference.discrepancy.inputs import Support

# At most so many rounds, until nothing changes by more than this share.
_ROUNDS, _SETTLED = 3, 0.02


def read_back(
    posterior: Posterior, data: Data, kept: Sequence[np.ndarray], errors: Sequence[Error]
) -> tuple[Posterior, Data, Maximum, "AbstractDiscrepancy | None"]:
    """The result of `most_probable`, from its stored arrays."""
    size = len(arrays_of(posterior.population))
    declared, rest = kept[0], kept[1 + size :]
    posterior = posterior.inflated(declared / np.asarray(posterior.declared))
    posterior = eqx.tree_at(lambda p: p.population, posterior, tree_like(posterior.population, kept[1 : 1 + size]))
    weights, memory, *rest = map(jnp.asarray, rest)
    data, process = data._replace(weights=weights, memory=memory), None
    if any(error.discrepancy for error in errors):
        from hsed_jax.inference.discrepancy import kinds

        process, rest = kinds.read_back(posterior, rest)
        data = data._replace(decorrelation=process.whitening)
    each = len(Maximum._fields) - 1
    best, *others = (Maximum._make([*rest[i : i + each], ()]) for i in range(0, len(rest), each))
    return posterior, data, best._replace(others=tuple(others)), process


def known_start(posterior: Posterior, data: Data, start: Float[Array, " q"]) -> Float[Array, " p"]:
    """The starting point at known parameters of the model: its inferred errors are the RMS of what these leave.

    With larger errors the prior would move the first steps away from there, into the basin of another mode.

    Arguments:
        posterior: with the declared errors.
        data: measured outputs.
        start: parameters of the model (SI).
    """
    theta = constrained(posterior, posterior.starts(1))[0].at[: start.size].set(start)
    u = unconstrained(posterior, theta[None])[0]
    (there,) = expand(posterior, data, [np.asarray(u)])
    standardised = np.asarray(against_declared(posterior, data, posterior, u, there.predicted, there.ok))
    for output, place in posterior.inferred:
        own = (np.asarray(data.weights) > 0) & (posterior.groups == output) & (np.asarray(there.ok) > 0)[:, None]
        if own.any():
            theta = theta.at[place].multiply(float(np.sqrt(np.mean(standardised[own] ** 2))))
    return unconstrained(posterior, theta[None])[0]


def most_probable(
    posterior: Posterior,
    data: Data,
    points: Float[Array, "s p"],
    errors: Sequence[Error],
    support: "Support | None",
    is_known: bool,
) -> tuple[Posterior, Data, Maximum, "AbstractDiscrepancy | None"]:
    """The MAP, with the weights of the samples, the errors and the discrepancy that belong to it.

    Arguments:
        posterior: with the declared errors.
        data: measured outputs.
        points: starts of the search.
        errors: of the outputs.
        support: the variables of a discrepancy of quantities.
        is_known: whether the first start is near the MAP; then its residual gives the initial errors.
    """
    declared, process, is_centred = posterior, None, False
    if any(error.discrepancy for error in errors):
        from hsed_jax.inference.discrepancy.kinds import none_yet

        data = none_yet(posterior, data)
    elif is_known:
        posterior, data, _, _ = _judged(posterior, posterior, data, points[0], errors, support, None)
    maximum = maximise(posterior, data, points)
    for _ in range(_ROUNDS):
        posterior, data, process, is_settled = _judged(declared, posterior, data, maximum.u, errors, support, process)
        if is_settled and (is_centred or not posterior.population.levels):
            break
        posterior, is_centred = centred(posterior, data, maximum.theta), True
        # With other errors the modes move; the starts over the whole prior were searched before.
        points = unconstrained(posterior, jnp.stack([mode.theta for mode in maximum.modes]))
        maximum = maximise(posterior, data, points)
    return posterior, data, maximum, process


def _judged(
    declared: Posterior,
    posterior: Posterior,
    data: Data,
    u: Array,
    errors: Sequence[Error],
    support: "Support | None",
    process: "AbstractDiscrepancy | None",
) -> tuple[Posterior, Data, "AbstractDiscrepancy | None", bool]:
    """Errors, weights of the samples and discrepancy from the residual at u, and whether they are unchanged."""
    # By the program that finds the MAP: another one takes seconds to compile.
    (there,) = expand(posterior, data, [np.asarray(u)])
    standardised = np.asarray(against_declared(declared, data, posterior, u, there.predicted, there.ok))
    noise_estimate = noise_left(standardised, data, declared, errors)
    inflated = declared.inflated(_left(standardised, data, declared, errors))
    # A discrepancy has its own correlation of the residuals.
    worth = (
        np.where([error.discrepancy for error in errors], 1.0, noise_estimate.worth) if errors else noise_estimate.worth
    )
    weights = jnp.asarray((np.asarray(data.weights) > 0) * worth[posterior.groups])
    learned = None
    if any(error.discrepancy for error in errors):
        from hsed_jax.inference.discrepancy import kinds

        learned = kinds.learned(declared, data, u, errors, support, process)
    found = (weights, noise_estimate.memory, inflated.declared, *(() if learned is None else learned.settling))
    before = (data.weights, data.memory, posterior.declared, *(() if process is None else process.settling))
    if len(found) == len(before) and all(
        np.allclose(old, new, rtol=_SETTLED) for old, new in zip(before, found, strict=True)
    ):
        return posterior, data, process, True
    data = data._replace(
        weights=weights,
        memory=jnp.asarray(noise_estimate.memory),
        decorrelation=None if learned is None else learned.whitening,
    )
    return inflated, data, learned, False


@program
def against_declared(declared, data, posterior, u, predicted, ok) -> Float[Array, "n J"]:
    """(f − y)/σ in units of the declared errors, where the outputs at u are known."""
    return declared.standardised(posterior.constrain(u), predicted, ok, data)


def noise_left(standardised: np.ndarray, data: Data, posterior: Posterior, errors: Sequence[Error]) -> NoiseEstimate:
    """The noise of each output from the residual, (n, J) in units of the declared errors."""
    used, gaps = np.asarray(data.weights) > 0, np.asarray(data.gaps)
    said = [error.correlated for error in errors] or [False] * len(posterior.outputs)
    return estimate_noise(standardised, gaps, used, posterior.groups, posterior.is_declared, said)


def _left(standardised: np.ndarray, data: Data, posterior: Posterior, errors: Sequence[Error]) -> np.ndarray:
    """Factor by which each declared error grows, (G,): the RMS of the residual, if it counts as error and exceeds one."""
    factors = np.ones(len(posterior.outputs))
    for output, error in enumerate(errors):
        own = (np.asarray(data.weights) > 0) & (posterior.groups == output)
        if error.inflate and error.is_declared and own.any():
            factors[output] = max(1.0, float(np.sqrt(np.mean(standardised[own] ** 2))))
    return factors


def left_unexplained(
    standardised: np.ndarray, data: Data, posterior: Posterior, noise_estimate: NoiseEstimate
) -> tuple[float | None, float | None]:
    """χ² per datum, and its probability under the declared noise; None if no noise is declared."""
    used = (np.asarray(data.weights) > 0) & posterior.is_declared[posterior.groups]
    if not used.any():
        return None, None
    noises = {g: noise for g, noise in enumerate(noise_estimate.noises) if posterior.is_declared[g]}
    p_value = size_p_value(standardised, used, noise_estimate.memory, noises, posterior.groups, posterior.fitted)
    return float(np.mean(standardised[used] ** 2)), p_value
