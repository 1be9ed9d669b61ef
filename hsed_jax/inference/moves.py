r"""Draws of an approximate posterior, moved until they are draws of the posterior itself.

Weights give the right density only where the approximation has draws, and if few draws carry most of the weight, little is
left of a tail.  Steps that leave the posterior invariant correct both (resample and move; Gilks & Berzuini 2001).  Each draw
takes the step $x' = x + \gamma(x_a - x_b)$ along the difference of two others and is accepted by Metropolis' rule
(differential evolution; ter Braak 2006).  The steps therefore have the width of the draws in every direction, and need no
derivative.

Along a thin bent ridge it takes hundreds of such steps to forget the initial position.  An emulator $\tilde\pi$ makes a hundred
of them for the cost of a few simulations.  Their end is then one proposal for the posterior, accepted with the probability
$\min(1, \pi(x')\tilde\pi(x) / \pi(x)\tilde\pi(x'))$ (surrogate transitions; Liu 2001).  This is exact for any error of the
emulator.  Where the emulator has no density, only steps by the simulator move a draw; every other sweep consists of these.

Draws have settled when their positions no longer depend on the positions half-way (Kantas, Beskos & Jasra 2014), and their
means and widths are the same as then.

Source: Gilks & Berzuini, J.  R.  Statist.  Soc.  B 63; ter Braak, Statistics and Computing 16; Liu, Monte Carlo Strategies in
Scientific Computing; Kantas, Beskos & Jasra, SIAM/ASA J.  Uncertainty Quantification 2.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.emulator import Emulator
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.watch import Watch
from hsed_jax.physics.batch import tiled_map
from hsed_jax.programs import program

# γ is this over √(2p), the best value for a Gaussian of p dimensions.  Half of the steps take a share of it with a uniform
# logarithm, because a thin bent ridge accepts short steps only.  One step in ten takes the whole difference, from mode to mode.
_LENGTH, _SHORTEST, _WHOLE = 2.38, 0.1, 0.1
# So many draws move.  Fewer do not show whether they have settled.  More are replaced by earlier positions of these.
_LEAST_WALKERS, _WALKERS = 250, 1000
# Steps by the emulator between two simulations of a draw; sweeps between two looks, and the most of them.
_BY_EMULATOR, _LOOK, _MOST = 100, 10, 200
# Standard errors within which a rank correlation counts as zero, and moments count as equal.
_SURE = 3.0
# Noise of a step, in standard deviations of the draws; without it, steps would stay on a lattice.
_JITTER = 1e-4

Wander = Callable[[Any, Any, PRNGKeyArray], tuple[Any, Any]]


class Moved(NamedTuple):
    """Draws after their moves.

    Attributes:
        points: u, (N, p).
        log_density: log density there, (N,).
        settled: whether they are independent of their positions half-way, with the same mean and width.
        worth: upper bound of the effective number of draws.
        sweeps: simulations of each draw that moved.
    """

    points: Float[np.ndarray, "N p"]
    log_density: Float[np.ndarray, " N"]
    settled: bool
    worth: int
    sweeps: int


def moved(
    log_densities: Callable[[np.ndarray], np.ndarray],
    wander: Wander,
    points: Float[np.ndarray, "N p"],
    log_density: Float[np.ndarray, " N"],
    random: np.random.Generator,
    watch: Watch,
    name: str,
    seconds: float | None = None,
) -> Moved:
    """Move draws until they have settled, or the budget of time or of sweeps ends.

    Arguments:
        log_densities: log density of many points, -inf without one.
        wander: the ends of emulator steps from some draws, given other draws, and the increase of its log density
            (`wandered`).
        points, log_density: draws in u, and their log density.
        random: the source of the steps.
        watch: receives the progress, and stores the moved draws.
        name: to keep them under.
        seconds: budget.
    """
    if (known := watch.recall(name)) is not None:
        return Moved(known[0], known[1], bool(known[2]), int(known[3]), int(known[4]))
    began, wanted, settled, sweep = time.perf_counter(), len(points), False, 0
    chosen = np.resize(random.permutation(wanted), min(max(wanted, _LEAST_WALKERS), _WALKERS))
    points, log_density = points[chosen], log_density[chosen]
    passed, kept = [points.copy()], [(points, log_density)]
    watch.report("draws moved by the emulator and the simulator")
    for sweep in range(1, _MOST + 1):
        # Moving draws use differences of standing ones, so every step leaves the posterior invariant.
        order = random.permutation(len(points))
        halves = order[: len(order) // 2], order[len(order) // 2 :]
        for going, standing in (halves, halves[::-1]):
            key = jax.random.key(int(random.integers(2**31)))
            propose = wander if sweep % 2 else directly
            those, others = jax.device_put((points[going], points[standing]))
            tried, gain = map(np.asarray, propose(those, others, key))
            there = log_densities(tried)
            taken = np.log(random.uniform(size=len(going))) < there - log_density[going] - gain
            points[going] = np.where(taken[:, None], tried, points[going])
            log_density[going] = np.where(taken, there, log_density[going])
        watch.count(sweep, _MOST)
        is_late = seconds is not None and time.perf_counter() - began > seconds
        if settled and (sweep % _LOOK == 0 or is_late):
            kept.append((points.copy(), log_density.copy()))
        elif sweep % _LOOK == 0:
            passed.append(points.copy())
            half = passed[len(passed) // 2]
            settled = _memory(half, points) < _SURE / np.sqrt(len(points)) and _are_alike(half, points)
            kept = [(points.copy(), log_density.copy())]
        if is_late or (settled and len(kept) * len(points) >= wanted):
            break
    rows = np.arange(wanted) % (len(kept) * len(points))
    of_points, of_density = (np.concatenate(part)[rows] for part in zip(*kept, strict=True))
    found = Moved(of_points, of_density, settled, min(wanted, len(points)), sweep)
    watch.keep(name, [np.asarray(part) for part in found])
    return found


@program
def directly(
    going: Float[Array, "N p"], standing: Float[Array, "M p"], key: PRNGKeyArray
) -> tuple[Float[Array, "N p"], Float[Array, " N"]]:
    """One step that the simulator alone decides, as `wandered` with a constant emulator."""
    return _stepped(going, standing, key), jnp.zeros(len(going))


@program
def wandered(
    posterior: Posterior,
    data: Data,
    emulator: Emulator,
    going: Float[Array, "N p"],
    standing: Float[Array, "M p"],
    key: PRNGKeyArray,
) -> tuple[Float[Array, "N p"], Float[Array, " N"]]:
    """The ends of many steps by the emulator, and its log density there minus that at the starts.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        emulator: decides on the steps.
        going: draws that move, in u.
        standing: draws whose differences give the steps.
        key: of the random numbers.
    """

    log_densities = jax.vmap(lambda x: emulator.log_density(posterior, x, data))

    def step(number, state):
        u, log_density, start = state
        # Before the first step, the loop computes the log density at the starts: a program with it twice compiles twice as long.
        begins = number < 0
        of_step, of_choice = jax.random.split(jax.random.fold_in(key, number))
        tried = jnp.where(begins, u, _stepped(u, standing, of_step))
        there = tiled_map(log_densities, tried)
        taken = begins | (jnp.log(jax.random.uniform(of_choice, (len(u),))) < there - log_density)
        kept = jnp.where(taken, there, log_density)
        return jnp.where(taken[:, None], tried, u), kept, jnp.where(begins, there, start)

    unknown = jnp.zeros(len(going))
    end, log_density, start = jax.lax.fori_loop(-1, _BY_EMULATOR, step, (going, unknown, unknown))
    return end, log_density - start


def _stepped(going: Float[Array, "N p"], standing: Float[Array, "M p"], key: PRNGKeyArray) -> Float[Array, "N p"]:
    """A step of each draw along the difference of two standing draws."""
    count, (many, size) = len(going), standing.shape
    of_first, of_second, of_kind, of_share, of_jitter = jax.random.split(key, 5)
    first = jax.random.randint(of_first, (count,), 0, many)
    second = (first + jax.random.randint(of_second, (count,), 1, many)) % many
    share = _SHORTEST ** jnp.maximum(jax.random.uniform(of_share, (count,), minval=-1.0), 0.0)
    is_whole = jax.random.uniform(of_kind, (count,)) < _WHOLE
    length = jnp.where(is_whole, 1.0, share * _LENGTH / np.sqrt(2 * size))
    jitter = _JITTER * jnp.std(standing, axis=0) * jax.random.normal(of_jitter, going.shape)
    return going + length[:, None] * (standing[first] - standing[second]) + jitter


def _memory(before: Float[np.ndarray, "N p"], after: Float[np.ndarray, "N p"]) -> float:
    """Largest rank correlation of a coordinate with itself (Spearman)."""
    ranks = (np.argsort(np.argsort(values, axis=0), axis=0) for values in (before, after))
    one, other = (rank - rank.mean(axis=0) for rank in ranks)
    return float(np.max(np.abs(np.sum(one * other, axis=0)) / np.sum(one**2, axis=0)))


def _are_alike(before: Float[np.ndarray, "N p"], after: Float[np.ndarray, "N p"]) -> bool:
    """Whether means and standard deviations of two sets of independent draws differ by no more than chance."""
    count, wide = len(after), after.std(axis=0)
    kurtosis = np.mean((after - after.mean(axis=0)) ** 4, axis=0) / wide**4
    of_means = np.abs(after.mean(axis=0) - before.mean(axis=0)) / (wide * np.sqrt(2 / count))
    of_widths = np.abs(np.log(wide / before.std(axis=0))) / np.sqrt((kurtosis - 1) / (2 * count))
    return bool(max(of_means.max(), of_widths.max()) < _SURE)
