"""NUTS (numpyro) in whitened coordinates with vectorised chains, and the diagnostics of its draws.

The posterior of a calibration is nearly Gaussian.  Whitened by the Gauss–Newton curvature at its mode it is nearly standard
normal, so no mass matrix is adapted. Only the step size is adapted, from that of the previous step.

One program serves chains and blocks of any length.  Between blocks the chains can be watched and stopped.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key
from numpyro.infer.hmc import HMCState, hmc
from numpyro.infer.hmc_util import build_adaptation_schedule
from numpyro.infer.util import ParamInfo

from hsed_jax.inference.emulator import Emulator
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.posterior import Posterior
from hsed_jax.programs import program

# Number of parameters that a warning names.
_NAMED = 3
# The adaptation of every chain ends before the iteration with this number, and the first iteration is numbered accordingly: the
# program then does not depend on the length of the adaptation.
_ADAPTED = 1_000_000
# A program has room for so many iterations, or for this times a power of two.
_ROOM = 1024


class Settings(NamedTuple):
    """Numbers of chains, of adaptation draws and of kept draws per chain, target acceptance, and the sampler."""

    chains: int = 4
    warmup: int = 100
    draws: int = 500
    target_acceptance: float = 0.8
    sampler: str = "nuts"


class Chains(NamedTuple):
    """Draws of a posterior.

    Attributes:
        theta: draws, SI, shape (chains, draws, p).
        log_density: log density in u, by the simulator, shape (chains, draws).
        diverging: divergent transitions, shape (chains, draws).
        steps: leapfrog steps per draw, shape (chains, draws); none where the draws are independent.
        step_size: the adapted step size of each chain, shape (chains,).
        sampler: that drew them: `nuts`, `importance` or `laplace` (of the Gaussian around the mode, not of the posterior).
        worth: number of independent draws that they are worth at most.
        emulator_error: of the log density of the emulator that NUTS used, before the weighting [nats]; None if NUTS used the
            simulator.
        doubt: the reason if they are less than requested, in a sentence; otherwise None.
    """

    theta: Float[Array, "chains draws p"]
    log_density: Float[Array, "chains draws"]
    diverging: Bool[Array, "chains draws"]
    steps: Int[Array, "chains draws"]
    step_size: Float[Array, " chains"]
    sampler: str = "nuts"
    worth: float = np.inf
    emulator_error: float | None = None
    doubt: str | None = None


class ChainState(NamedTuple):
    """The state of chains in lockstep, with all that continuing needs.

    Attributes:
        state: numpyro's, of each chain.
        kept: whitened draws, potential, divergence and leapfrog steps of every iteration, adaptation first; zero for later
            iterations, (room, chains, …).
        done, planned: iterations that were made, and that are to be made.
        work: their leapfrog steps; chains wait for the longest trajectory among them.
    """

    state: HMCState
    kept: tuple[Array, ...]
    done: Int[Array, ""]
    planned: Int[Array, ""]
    work: Int[Array, ""]


def begin(maximum: Maximum, step_size: Float[Array, ""], keys: Key[Array, " chains"], settings: Settings) -> ChainState:
    """Chains before their first iteration.

    Arguments:
        maximum: the mode to start from and the whitening (`maximise`).
        step_size: to begin adaptation from.
        keys: of the random numbers, one for each chain.
        settings: sizes.
    """
    room = _ROOM
    while room < settings.warmup + settings.draws:
        room *= 2
    warmup, draws = jnp.asarray(settings.warmup, int), jnp.asarray(settings.draws, int)
    return _begun(maximum, step_size, keys, warmup, draws, room)


@program
def _begun(
    maximum: Maximum,
    step_size: Float[Array, ""],
    keys: Key[Array, " chains"],
    warmup: Int[Array, ""],
    draws: Int[Array, ""],
    room: int,
) -> ChainState:
    def first(key):
        scattered, key = jax.random.split(key)
        w = jax.random.normal(scattered, (maximum.start.size,))
        start, _ = hmc(potential_fn=jnp.sum, algo="NUTS")
        # The first iteration computes potential and gradient, with the program that all iterations use.
        state = _started(start, ParamInfo(w, jnp.zeros(()), jnp.zeros_like(w)), step_size, key)
        return state._replace(i=_ADAPTED - warmup)

    state = jax.vmap(first)(keys)
    kept = jax.tree.map(lambda values: jnp.zeros((room, *values.shape), values.dtype), _worth_keeping(state))
    return ChainState(state, kept, jnp.zeros((), int), warmup + draws, jnp.zeros((), int))


@program
def advance(
    posterior: Posterior,
    data: Data,
    maximum: Maximum,
    target: Float[Array, ""],
    emulator: Emulator | None,
    chain_state: ChainState,
    most: Int[Array, ""],
) -> ChainState:
    """Let chains continue to their end, or for a number of leapfrog steps. The draws do not depend on the position of a stop.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        maximum: the mode and the whitening.
        target: acceptance of the steps that the adaptation aims at.
        emulator: replaces the simulator; None for the simulator itself.
        chain_state: the chains.
        most: number of leapfrog steps after which no iteration begins.
    """
    place, frame = maximum.start, maximum.whitening

    def potential_of(data):
        def potential(w):
            u = place + frame @ w
            if emulator is None:
                return -posterior.log_density(u, data)
            return -emulator.log_density(posterior, u, data)

        return potential

    def entered(state):
        potential, slope = jax.vmap(jax.value_and_grad(potential_of(data)))(state.z)
        return state._replace(potential_energy=potential, z_grad=slope)

    start, draw = hmc(potential_fn_gen=potential_of, algo="NUTS")
    # numpyro's kernel takes its settings from its initial state, which is not that of a chain here.
    nowhere = ParamInfo(place, jnp.zeros(()), place)
    _started(start, nowhere, jnp.ones(()), jax.random.key(0), data, target=target)
    move = jax.vmap(lambda state: draw(state, (data,)))
    before = chain_state.work

    def one(chain_state):
        state = move(chain_state.state)
        kept = jax.tree.map(lambda all, new: all.at[chain_state.done].set(new), chain_state.kept, _worth_keeping(state))
        work = chain_state.work + jnp.max(state.num_steps)
        return chain_state._replace(state=state, kept=kept, done=chain_state.done + 1, work=work)

    # Adaptation and draws in one loop: two loops would take twice as long to trace and compile.
    state = jax.lax.cond(chain_state.done == 0, entered, lambda state: state, chain_state.state)
    return jax.lax.while_loop(
        lambda chain_state: (chain_state.done < chain_state.planned) & (chain_state.work - before < most),
        one,
        chain_state._replace(state=state),
    )


def _worth_keeping(state: HMCState) -> tuple[Array, ...]:
    return state.z, state.potential_energy, state.diverging, state.num_steps


def _started(
    start, at: ParamInfo, step_size: Float[Array, ""], key, *data: Data, target: Float[Array, ""] | float = 0.8
) -> HMCState:
    """The initial state, which does not depend on the target of the adaptation."""
    state = start(
        at,
        _ADAPTED,
        step_size=step_size,
        adapt_mass_matrix=False,
        target_accept_prob=target,
        max_tree_depth=7,
        model_args=data,
        rng_key=key,
    )
    # numpyro forgets the step size where it would have learnt a mass matrix, shortly before the adaptation ends.  Here none is
    # learnt: the adaptation is one window, its last.
    adapted = state.adapt_state
    last = jnp.full_like(adapted.window_idx, len(build_adaptation_schedule(_ADAPTED)) - 1)
    return state._replace(adapt_state=adapted._replace(window_idx=last))


@eqx.filter_jit
def arrived(
    posterior: Posterior, maximum: Maximum, chain_state: ChainState, settings: Settings
) -> tuple[Any, Array, Array]:
    """The draws of chains without adaptation: θ, log density in u, divergence and leapfrog steps of every draw; its u;
    and the step sizes. Draws that are not made yet have no meaning.
    """
    drawn = slice(settings.warmup, settings.warmup + settings.draws)
    w, potential, diverging, steps = (jnp.swapaxes(x[drawn], 0, 1) for x in chain_state.kept)
    u = maximum.start + w @ maximum.whitening.T
    theta = jax.vmap(jax.vmap(posterior.constrain))(u)
    return (theta, -potential, diverging, steps), u, chain_state.state.adapt_state.step_size


class Convergence(NamedTuple):
    """Diagnostics of the draws: split R-hat and bulk ESS per parameter (Vehtari et al. 2021), divergences."""

    rhat: np.ndarray
    ess_bulk: np.ndarray
    divergences: int

    def warning(self, names: tuple[str, ...]) -> str | None:
        """The problems of the draws in one sentence, or None."""
        faults: list[str] = []
        # NaN is a fault, too.
        if (is_wrong := ~(self.rhat <= 1.01)).any():
            worst = f"{np.max(self.rhat[is_wrong]):.3f} (should be at most 1.01)"
            faults.append(f"R-hat of {_some(names, is_wrong, 'up to')} {worst}")
        if (is_wrong := ~(self.ess_bulk >= 400)).any():
            worst = f"{np.min(self.ess_bulk[is_wrong]):.0f} (should be at least 400)"
            faults.append(f"bulk ESS of {_some(names, is_wrong, 'down to')} {worst}")
        if self.divergences:
            faults.append(f"{self.divergences} divergent transitions (should be none)")
        return "; ".join(faults) or None


def _some(names: tuple[str, ...], chosen: np.ndarray, reach: str) -> str:
    """The chosen parameters with their verb: `A is`, or `A, beta, n and 4 others is up to`."""
    found = [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    more = len(found) - _NAMED
    rest = f" and {more} other{'s' * (more > 1)}" if more > 0 else ""
    return ", ".join(found[:_NAMED]) + rest + (" is" if len(found) == 1 else f" is {reach}")


def convergence(chains: Chains) -> Convergence:
    """R-hat, bulk ESS and divergences of the draws."""
    from arviz_stats.base.array import array_stats

    draws = np.moveaxis(np.asarray(chains.theta), -1, 0)
    # Chains that stand still have no variance: their R-hat is not a number, and counts as bad.
    with np.errstate(divide="ignore", invalid="ignore"):
        return Convergence(
            np.asarray([array_stats.rhat(d, chain_axis=0, draw_axis=1) for d in draws], dtype=float),
            np.asarray([min(array_stats.ess(d, chain_axis=0, draw_axis=1), chains.worth) for d in draws], dtype=float),
            int(np.sum(np.asarray(chains.diverging))),
        )


def summarise(names: tuple[str, ...], chains: Chains, judged: Convergence) -> dict[str, dict[str, float]]:
    """Mean, sd, quantiles and diagnostics of each parameter's draws."""
    draws = np.asarray(chains.theta)[..., : len(names)].reshape(-1, len(names))
    return {
        name: {
            **statistics_of(draws[:, i]),
            "ess_bulk": float(judged.ess_bulk[i]),
            "rhat": float(judged.rhat[i]),
        }
        for i, name in enumerate(names)
    }


def statistics_of(draws: Float[np.ndarray, " S"]) -> dict[str, float]:
    """Mean, sd, 5 % and 95 % quantile of draws of a number."""
    q05, q95 = np.quantile(draws, [0.05, 0.95])
    return {"mean": float(draws.mean()), "sd": float(draws.std(ddof=1)), "q05": float(q05), "q95": float(q95)}
