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
# A lane takes as long as its program has parameters, those of the law about this many.  A further program is made once it would
# have saved so many lanes of one parameter: that is what it costs to compile.
_LAW, _WORTHWHILE = 3, 200_000


_Effects = frozenset[str]


class Part(NamedTuple):
    """A candidate in the large model.

    Attributes:
        effect: its name.
        group: those of one group share a program from the start.
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

    An effect that is neutral does exactly nothing, and costs as much as any other: a lane runs the cheapest program that has its
    effects.  There are those of single groups and that of all; what a search comes back to gets programs of its own.

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
        self._parts = {part.effect: part for part in parts}
        groups = {part.group: frozenset(p.effect for p in parts if p.group == part.group) for part in parts}
        self._group = {part.effect: groups[part.group] for part in parts}
        self._available = list(dict.fromkeys([frozenset(), *groups.values(), frozenset(self._parts)]))
        self._saved: Counter[_Effects] = Counter()
        self._programs: dict[_Effects, tuple[Outputs, np.ndarray]] = {}
        self._threads = ThreadPoolExecutor(cores())

    def __call__(
        self, thetas: Float[np.ndarray, "L P"], experiments: Int[np.ndarray, " L"]
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """Outputs (L, J) and whether each lane converged (L,); outputs of a lane that diverged are zero."""
        chunks = [
            (*self._program(effects), lanes[start : start + _CHUNK])
            for effects, lanes in self._by_program(thetas).items()
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

    def _by_program(self, thetas: Float[np.ndarray, "L P"]) -> dict[_Effects, Int[np.ndarray, " l"]]:
        """Lanes by the effects of the program that they run."""
        has = [np.any(thetas[:, part.columns] != part.neutral, axis=1) for part in self._parts.values()]
        found: dict[_Effects, list[np.ndarray]] = {}
        kinds, kind_of = np.unique(np.reshape(has, (len(has), len(thetas))).T, axis=0, return_inverse=True)
        for number, kind in enumerate(kinds):
            effects = frozenset(effect for effect, one in zip(self._parts, kind, strict=True) if one)
            lanes = np.flatnonzero(kind_of.ravel() == number)
            found.setdefault(self._serving(effects, len(lanes)), []).append(lanes)
        return {effects: np.concatenate(lanes) for effects, lanes in found.items()}

    def _serving(self, effects: _Effects, lanes: int) -> _Effects:
        """The effects of the program for lanes that have these: of the cheapest one there is, or of one that has become worth it.

        It may have them alone; in place of one of them its group, which serves all that is tried beside the others; or all their
        groups.
        """
        serving = min((one for one in self._available if effects <= one), key=self._cost)
        beside = [effects - {one} | self._group[one] for one in sorted(effects)]
        others = dict.fromkeys([effects, *beside, frozenset().union(*beside)])
        for other in others:
            self._saved[other] += lanes * max(self._cost(serving) - self._cost(other), 0)
        best = max(others, key=self._saved.__getitem__)
        if self._saved[best] <= _WORTHWHILE:
            return serving
        self._available.append(best)
        self._saved = Counter({other: saved for other, saved in self._saved.items() if not other <= best})
        return best

    def _cost(self, effects: _Effects) -> int:
        return _LAW + sum(len(self._parts[effect].columns) for effect in effects)

    def _program(self, effects: _Effects) -> tuple[Outputs, Int[np.ndarray, " p"]]:
        """The model with these effects only, and the columns of its parameters; made once."""
        if effects in self._programs:
            return self._programs[effects]
        left_out = set(self._parts) - effects
        columns = [k for k, name in enumerate(self._names) if owner_of(name) not in left_out]
        model = self._model
        if left_out:
            assert isinstance(model, Simulator)
            model = replace(model, effects=model.effects.only(e for e in model.effects if e not in left_out))
        outputs = Outputs(model, self._observation, tuple(self._names[k] for k in columns))
        self._programs[effects] = outputs, np.asarray(columns)
        return self._programs[effects]


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
