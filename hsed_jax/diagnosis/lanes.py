"""Predictions for many pairs of parameters and experiments, by one compiled program of a fixed size.

What differs between two studies of the same kind (masses, scales, data, parameters) is an operand of the program, not a
constant in it, so that a process that looks at a hundred campaigns compiles once.  Chunks go to threads: XLA runs a program of
this kind on one core, and several at a time on several.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
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
from hsed_jax.physics.simulator import AbstractModel, Conditions, Simulator
from hsed_jax.programs import program

# Chunks go to threads; their tiles are small, since most rounds ask for a few lanes of each program.
_CHUNK, _TILE = 64, 8
_FAR = 1e100
# A step of a lane takes as long as its program has parameters, those of the law about this many.  A further program is made once
# it would have saved as many steps with one parameter as it costs to compile: so many for a program, and so many for each of
# its parameters.
_LAW, _PROGRAM, _PARAMETER = 3, 20_000_000, 5_000_000


_Columns = frozenset[int]
"""Parameters of effects that a program has, by their place in a parameter vector; all others are neutral in it."""


class Part(NamedTuple):
    """A candidate in the large model.

    Attributes:
        effect: its name.
        group: those of one group are likely to be tried beside the same others, and share programs.
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

    An effect that is neutral does exactly nothing, and costs as much as any other; and so does what a form of an effect leaves
    out.  A lane runs the cheapest program that has its parameters, where others are numbers that the compiler knows.  Programs
    are made for what is asked for; what a search comes back to gets programs of its own.

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
        self._of_effect = {part.effect: frozenset(part.columns.tolist()) for part in parts}
        self._group = {part.effect: part.group for part in parts}
        self._neutral = dict(zip(_joined([p.columns for p in parts]), _joined([p.neutral for p in parts]), strict=True))
        self._of_group = {
            part.effect: frozenset[int]().union(*(self._of_effect[p.effect] for p in parts if p.group == part.group))
            for part in parts
        }
        self._available: list[_Columns] = []
        # Of groups of effects, what was missing so far.
        self._provided: dict[frozenset[int], _Columns] = {}
        self._saved: Counter[_Columns] = Counter()
        self._programs: dict[_Columns, tuple[Outputs, np.ndarray]] = {}
        self._threads = ThreadPoolExecutor(cores())

    def __call__(
        self, thetas: Float[np.ndarray, "L P"], experiments: Int[np.ndarray, " L"]
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """Outputs (L, J) and whether each lane converged (L,); outputs of a lane that diverged are zero."""
        served = [(*self._program(columns), lanes) for columns, lanes in self._by_program(thetas).items()]
        # The first chunk of each program before all others, so that programs are made side by side.
        chunks = [
            (outputs, columns, lanes[start : start + _CHUNK])
            for start in range(0, len(thetas), _CHUNK)
            for outputs, columns, lanes in served
            if start < len(lanes)
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

    def _by_program(self, thetas: Float[np.ndarray, "L P"]) -> dict[_Columns, Int[np.ndarray, " l"]]:
        """Lanes by the parameters of effects in the program that they run."""
        columns = np.asarray(list(self._neutral), dtype=int)
        has = thetas[:, columns] != np.asarray(list(self._neutral.values()))
        kinds, kind_of, counts = np.unique(has, axis=0, return_inverse=True, return_counts=True)
        needs = [frozenset(columns[kind].tolist()) for kind in kinds]
        asked = dict(zip(needs, counts.tolist(), strict=True))
        if missing := {needed: lanes for needed, lanes in asked.items() if not self._is_there(needed)}:
            self._provide(missing)
        for needed, lanes in asked.items():
            self._count(needed, lanes)
        found: dict[_Columns, list[np.ndarray]] = {}
        for number, needed in enumerate(needs):
            found.setdefault(self._serving(needed), []).append(np.flatnonzero(kind_of.ravel() == number))
        return {columns: np.concatenate(lanes) for columns, lanes in found.items()}

    def _provide(self, missing: Mapping[_Columns, int]) -> None:
        """Have programs for so many lanes with each of these parameters, which none has: one for those with effects of the same
        groups, or one for all of them, whichever costs less.  What is missing again gets what had been missing as well."""
        apart: dict[frozenset[int], _Columns] = {}
        lanes: Counter[frozenset[int]] = Counter()
        for needed, count in missing.items():
            groups = frozenset(self._group[effect] for effect, own in self._of_effect.items() if own & needed)
            apart[groups] = apart.get(groups, self._provided.get(groups, frozenset())) | needed
            lanes[groups] += count
        together = frozenset[int]().union(*apart)
        whole = self._provided.get(together, frozenset[int]()).union(*missing)
        price_apart = sum(self._price(columns, lanes[groups]) for groups, columns in apart.items())
        chosen = apart if price_apart < self._price(whole, lanes.total()) else {together: whole}
        self._provided |= chosen
        self._available += chosen.values()

    def _count(self, needed: _Columns, lanes: int) -> None:
        """Count what programs would have saved for lanes with these parameters."""
        cost = self._cost(self._there(needed))
        for other in self._options(needed):
            self._saved[other] += lanes * max(cost - self._cost(other), 0)

    def _serving(self, needed: _Columns) -> _Columns:
        """The program for lanes with these parameters: the cheapest one there is, or one that has become worth it."""

        def worth(columns: _Columns) -> int:
            return self._saved[columns] * self._steps - self._price(columns)

        best = max(self._options(needed), key=worth)
        if worth(best) > 0:
            self._available.append(best)
            self._saved = Counter({other: saved for other, saved in self._saved.items() if not other <= best})
        return self._there(needed)

    def _there(self, needed: _Columns) -> _Columns:
        """The cheapest program there is for lanes with these parameters."""
        return min((one for one in self._available if needed <= one), key=self._cost)

    def _is_there(self, needed: _Columns) -> bool:
        return any(needed <= one for one in self._available)

    def _options(self, needed: _Columns) -> list[_Columns]:
        """Programs for lanes with these parameters: one that has them alone; one that has all forms of the effects, or of one of
        them; or the group of one of them, which serves all that is tried beside the others; or all their groups."""
        effects = [effect for effect, own in self._of_effect.items() if needed & own]
        forms = [needed | self._of_effect[one] for one in effects]
        beside = [needed | self._of_group[one] for one in effects]
        unions = [frozenset[int]().union(*some) for some in (forms, beside)]
        return list(dict.fromkeys([needed, *forms, *beside, *unions]))

    def _price(self, columns: _Columns, lanes: int = 0) -> int:
        """What it costs to make a program, and to run so many lanes of it."""
        return _PROGRAM + _PARAMETER * len(columns) + lanes * self._steps * self._cost(columns)

    def _cost(self, columns: _Columns) -> int:
        """What a step of a lane costs."""
        return _LAW + len(columns)

    @property
    def _steps(self) -> int:
        """How many steps a lane takes."""
        return 1 if self._model.timeline is None else self._model.timeline.steps

    def _program(self, has: _Columns) -> tuple[Outputs, Int[np.ndarray, " p"]]:
        """The model with these parameters of effects only, and the columns of all its parameters; made once."""
        if has in self._programs:
            return self._programs[has]
        columns = [k for k in range(len(self._names)) if k in has or k not in self._neutral]
        left_out = {effect for effect, own in self._of_effect.items() if not own & has}
        model = self._model
        if left_out:
            assert isinstance(model, Simulator)
            model = replace(model, effects=model.effects.only(e for e in model.effects if e not in left_out))
        outputs = Outputs(model, self._observation, tuple(self._names[k] for k in columns))
        self._programs[has] = outputs, np.asarray(columns)
        return self._programs[has]


def _joined(arrays: Sequence[np.ndarray]) -> list:
    return [value for array in arrays for value in array.tolist()]


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
