"""A fitted model of the package under numerical experiments."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hsed_jax.backend import cores
from hsed_jax.behaviour.histories import Imposition
from hsed_jax.physics.effects.base import AbstractSpringEffect
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.outputs import owner_of
from hsed_jax.physics.simulator import Conditions, Recorded, Simulator
from hsed_jax.physics.timeline import Timeline
from hsed_jax.programs import program

# A step is at most this share of the yield elongation, and a range is followed in no more steps than these.
_PER_YIELD, _FINEST = 0.2, 200
# Simulations that run together: eight fill a vector register, and wider chunks take more time for each simulation.
_CHUNK = 8
# A force of so many characteristic forces is that of a model which diverges.
_DIVERGED = 1e3


class Answers(NamedTuple):
    """Forces of several models.

    Attributes:
        force: at the start and at the ends of the steps [N], (M, B, n+1).
        ok: whether the simulation does not diverge and its steps are short enough, (M, B).
    """

    force: Float[np.ndarray, "M B samples"]
    ok: Bool[np.ndarray, "M B"]


def spring_effects(simulator: Simulator, element: Element) -> list[str]:
    """The effects of a model that are in the spring of a specimen."""
    return [
        name
        for name, effect in simulator.effects.items()
        if issubclass(effect, AbstractSpringEffect) and element.has(owner_of(name))
    ]


def alone(simulator: Simulator, element: Element, held: Mapping[str, float]) -> Simulator:
    """The specimen of a model without structure and test rig.

    Arguments:
        simulator: the model.
        element: the specimen.
        held: parameters of effects that are numbers for the compiler, by name.
    """
    return replace(
        simulator,
        structure=None,
        excitation=None,
        damping_follows_model=False,
        effects=simulator.effects.only(spring_effects(simulator, element)),
        constants=(*((n, v) for n, v in simulator.constants if n not in held), *sorted(held.items())),
        elements=(element,),
    )


def longest_step(yield_elongation: float, largest: float) -> float:
    """Step of the elongation that resolves a yielding specimen [m]."""
    return max(_PER_YIELD * min(yield_elongation, largest), largest / _FINEST)


def answers(specimen: Simulator, models: Sequence[Mapping[str, float]], histories: Imposition) -> Answers:
    """Forces of a specimen with different parameters, SI, by name."""
    steps, count = histories.lengths.shape[1], len(histories.lengths)
    timed = replace(specimen, timeline=Timeline(None, steps, 1))
    # A chunk of simulations takes as long as its longest history, without the steps before that begins.
    begins = np.argmax(histories.lengths > 0, axis=1)
    simulations = np.argsort(np.tile(begins, len(models)), kind="stable")
    force = np.zeros((len(simulations), steps + 1))
    ok = np.zeros(len(simulations), dtype=bool)

    def answer(start: int) -> None:
        own = simulations[start : start + _CHUNK]
        filled = np.pad(own, (0, _CHUNK - len(own)), mode="edge")
        of, row = np.divmod(filled, count)
        skipped = int(begins[row].min())
        parameters = {name: jnp.asarray([models[k][name] for k in of]) for name in models[0]}
        imposed = Imposed(_without(histories.elongation[row], 2 * skipped), _without(histories.rate[row], 2 * skipped))
        lengths, stop = _without(histories.lengths[row], skipped), jnp.asarray(steps - skipped)
        found, is_fine = (np.asarray(part)[: len(own)] for part in _forces(timed, parameters, imposed, lengths, stop))
        force[own] = np.pad(found[:, : steps + 1 - skipped], ((0, 0), (skipped, 0)), mode="edge")
        ok[own] = is_fine

    with ThreadPoolExecutor(cores()) as threads:
        list(threads.map(answer, range(0, len(simulations), _CHUNK)))
    ok &= np.abs(force).max(axis=1) <= _DIVERGED * float(specimen.scales.force)  # also False for NaN
    shape = (len(models), count)
    return Answers(force.reshape(*shape, steps + 1), ok.reshape(shape))


def _without(values: Float[np.ndarray, "B n"], first: int) -> Float[Array, "B n"]:
    """The columns after the first ones; the last column is repeated, so that the shape stays."""
    return jnp.asarray(np.pad(values[:, first:], ((0, 0), (0, first)), mode="edge"))


@program
def _forces(specimen, parameters, imposed, lengths, stop):
    def one(values, sample, length):
        response = specimen.respond(values, Conditions({}, Recorded(Tabulated(sample), length, stop=stop)), ("force",))
        return response.channels["force"], response.ok

    return jax.vmap(one)(parameters, imposed, lengths)
