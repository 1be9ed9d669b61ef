"""Predictions for many pairs of parameters and experiments, by one compiled program of a fixed size.

What differs between two studies of the same kind (masses, scales, data, parameters) is an operand of the program, not a
constant in it, so that a process that looks at a hundred campaigns compiles once.  Chunks go to threads: XLA runs a program of
this kind on one core, and several at a time on several.
"""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from hsed_jax.backend import cores
from hsed_jax.inference.observation import Observation, Outputs
from hsed_jax.physics.batch import tiled_map
from hsed_jax.physics.outputs import owner_of
from hsed_jax.physics.simulator import AbstractModel, Conditions, Simulator
from hsed_jax.programs import program

# Chunks go to threads; their tiles are small, since most rounds ask for a few lanes of each program.
_CHUNK, _TILE = 64, 16
_FAR = 1e100
# A program of several groups is compiled once so many lanes asked for it: before, the whole model costs less.
_WORTHWHILE = 2000


class Part(NamedTuple):
    """A candidate in the large model.

    Attributes:
        effect: its name.
        group: those of one group share a program.
        columns: of its parameters, (q,).
        neutral: what these are where it is absent, (q,).
    """

    effect: str
    group: int
    columns: Int[np.ndarray, " q"]
    neutral: Float[np.ndarray, " q"]


class Apart(NamedTuple):
    """How far the parameters of each experiment are from those of all, since its specimen has its own.

    Attributes:
        names: of the parameters.
        factor, shift: what each is multiplied by, and what is added, (n, K).
    """

    names: tuple[str, ...]
    factor: Float[np.ndarray, "n K"]
    shift: Float[np.ndarray, "n K"]

    def across(self, names: tuple[str, ...], rows: int) -> "Apart":
        """The same for all parameters of a larger model and for more experiments, which have those of all."""
        factor, shift = np.ones((rows, len(names))), np.zeros((rows, len(names)))
        for k, name in enumerate(self.names):
            column = names.index(name)
            factor[: len(self.factor), column] = self.factor[:, k]
            shift[: len(self.shift), column] = self.shift[:, k]
        return Apart(names, factor, shift)


class LanesApart(NamedTuple):
    """Lanes whose experiments have parameters of their own, relative to those that are asked for."""

    lanes: "Lanes"
    apart: Apart

    def __call__(
        self, thetas: Float[np.ndarray, "L P"], experiments: Int[np.ndarray, " L"]
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """As those of `Lanes`."""
        own = thetas * self.apart.factor[experiments] + self.apart.shift[experiments]
        return self.lanes(own, experiments)


class Lanes:
    """Outputs of a model over lanes, each a parameter vector and the number of an experiment.

    An effect that is neutral does exactly nothing, and costs as much as any other: a lane runs the program of the groups of
    effects that it has.

    Arguments:
        model: the computational model.
        observation: what of a response is predicted.
        names: of the parameters, in the order of a parameter vector.
        conditions: of the experiments, leading axis n.
        parts: the effects of a `Simulator` that a lane may lack.
    """

    def __init__(
        self,
        model: AbstractModel,
        observation: Observation,
        names: tuple[str, ...],
        conditions: Conditions,
        parts: Sequence[Part] = (),
    ):
        self._model, self._observation, self._names, self._conditions = model, observation, names, conditions
        self._parts, self._groups = parts, tuple(dict.fromkeys(part.group for part in parts))
        self._asked: Counter[tuple[int, ...]] = Counter()
        self._programs: dict[tuple[int, ...], tuple[Outputs, np.ndarray]] = {}
        self._threads = ThreadPoolExecutor(cores())

    def __call__(
        self, thetas: Float[np.ndarray, "L P"], experiments: Int[np.ndarray, " L"]
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """Outputs (L, J) and whether each lane converged (L,); outputs of a lane that diverged are zero."""
        chunks = [
            (*self._program(groups), lanes[start : start + _CHUNK])
            for groups, lanes in self._by_groups(thetas).items()
            for start in range(0, len(lanes), _CHUNK)
        ]

        def run(chunk: tuple[Outputs, np.ndarray, np.ndarray]):
            outputs, columns, lanes = chunk
            padding = ((0, _CHUNK - len(lanes)),)
            found, ok = _outputs(
                outputs,
                self._conditions,
                jnp.asarray(np.pad(thetas[lanes][:, columns], (*padding, (0, 0)), mode="edge")),
                jnp.asarray(np.pad(experiments[lanes], padding, mode="edge")),
                jnp.asarray(len(lanes)),
            )
            return np.asarray(found)[: len(lanes)], np.asarray(ok)[: len(lanes)]

        done = list(self._threads.map(run, chunks))
        order = np.argsort(np.concatenate([lanes for *_, lanes in chunks]))
        return np.concatenate([d[0] for d in done])[order], np.concatenate([d[1] for d in done])[order]

    def _by_groups(self, thetas: Float[np.ndarray, "L P"]) -> dict[tuple[int, ...], Int[np.ndarray, " l"]]:
        """Lanes by the groups of effects that they have, as far as these have a program of their own."""
        has = np.zeros((len(thetas), len(self._groups)), dtype=bool)
        for part in self._parts:
            has[:, self._groups.index(part.group)] |= np.any(thetas[:, part.columns] != part.neutral, axis=1)
        found: dict[tuple[int, ...], list[np.ndarray]] = {}
        kinds, kind_of = np.unique(has, axis=0, return_inverse=True)
        for number, kind in enumerate(kinds):
            groups = tuple(g for g, one in zip(self._groups, kind, strict=True) if one)
            lanes = np.flatnonzero(kind_of.ravel() == number)
            self._asked[groups] += len(lanes)
            is_own = len(groups) < 2 or self._asked[groups] > _WORTHWHILE
            found.setdefault(groups if is_own else self._groups, []).append(lanes)
        return {groups: np.concatenate(lanes) for groups, lanes in found.items()}

    def _program(self, groups: tuple[int, ...]) -> tuple[Outputs, Int[np.ndarray, " p"]]:
        """The model with effects of these groups only, and the columns of its parameters; made once."""
        if groups in self._programs:
            return self._programs[groups]
        left_out = {part.effect for part in self._parts if part.group not in groups}
        columns = [k for k, name in enumerate(self._names) if owner_of(name) not in left_out]
        model = self._model
        if left_out:
            assert isinstance(model, Simulator)
            model = replace(model, effects=model.effects.only(e for e in model.effects if e not in left_out))
        outputs = Outputs(model, self._observation, tuple(self._names[k] for k in columns))
        self._programs[groups] = outputs, np.asarray(columns)
        return self._programs[groups]


@program
def _outputs(respond, conditions, thetas, experiments, count):
    def one(lane):
        theta, experiment = lane
        at_it = jax.tree.map(lambda leaf: leaf[experiment], conditions)
        outputs, ok = respond(theta, at_it)
        # On its way to infinity a diverging simulation passes numbers whose squares are no numbers any more.
        ok = ok & jnp.all(jnp.abs(outputs) < _FAR)
        return jnp.where(ok, outputs, 0.0), ok

    outputs, ok = tiled_map(jax.vmap(one), (thetas, experiments), count=count, tile=_TILE)
    return outputs, ok.astype(float)
