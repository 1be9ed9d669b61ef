r"""Simulations of many models in one batch: pairs of a parameter vector and an experiment.

One program holds every candidate effect in its simplest shape with any driver.  It serves every set of effects, every campaign
of its kind and every record of about its length: masses, scales, data and parameters are operands.  An effect that is neutral
does exactly nothing in it, but costs as much as any other, and the shapes of all effects cost ten times that.  So other
programs hold all forms of the few effects whose forms are compared.  A choice of forms that is simulated again and again gets a
program of its own, in which all other parameters are numbers that the compiler knows, as soon as that would have paid for itself
(the rule of ski rental: at most twice the cost of knowing the number of simulations beforehand; Karlin et al. 1988).

Chunks of simulations go to threads: XLA runs a program of this kind on one core, and several at a time on several.
"""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from hsed_jax.backend import cores
from hsed_jax.inference.observation import Histories, Observation, Outputs
from hsed_jax.physics.batch import tiled_map
from hsed_jax.physics.simulator import AbstractModel, Conditions, Simulator
from hsed_jax.programs import program

# Simulations of a chunk, and those that run together: most rounds ask for a few of each set.
_CHUNK, _TILE = 64, 8
# So many samples more than are asked for: a sensor may be early.
_AHEAD = 16
# Outputs beyond this are on their way to infinity, and their squares would be no numbers.
_FAR = 1e100
# A program is made once it would have saved so many evaluations of a parameter in a step: about two seconds of either.
_PRICE = 300_000_000


@runtime_checkable
class Predictions(Protocol):
    """What makes predictions of many models, a `Batch`, say."""

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """Outputs and whether each simulation converged.

        Arguments:
            thetas: parameters.
            experiments: their numbers.
            samples: of a history so many are asked for, by default all that are used; later ones may be anything.
        """
        ...


Columns = frozenset[int]
"""Parameters of effects that a program has, by their place in a parameter vector; all others are neutral in it."""


class Part(NamedTuple):
    """A candidate in the large model.

    Attributes:
        effect: its name.
        columns: of its parameters, (q,).
        neutral: what these are where it is absent, (q,).
        simplest: columns of those that its simplest shape has, with any driver.
    """

    effect: str
    columns: Int[np.ndarray, " q"]
    neutral: Float[np.ndarray, " q"]
    simplest: frozenset[int]


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


class BatchApart(NamedTuple):
    """A batch whose experiments have parameters of their own, relative to those that are asked for."""

    batch: "Batch"
    apart: Apart

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """As those of `Batch`."""
        own = thetas * self.apart.factor[experiments] + self.apart.shift[experiments]
        return self.batch(own, experiments, samples)


class Selected(NamedTuple):
    """A batch of some of the experiments, known by their places among these.

    Attributes:
        batch: of all experiments.
        rows: places of the experiments among all, (r,).
    """

    batch: "Predictions"
    rows: Int[np.ndarray, " r"]

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """As that of `Batch`."""
        return self.batch(thetas, self.rows[experiments], samples)


class Batch:
    """Outputs of a model over simulations, each a parameter vector and the number of an experiment.

    Arguments:
        model: the computational model.
        observation: what of a response is predicted.
        names: of the parameters, in the order of a parameter vector.
        conditions: of the experiments, leading axis n.
        parts: the effects of a `Simulator` that a simulation may lack.
        used: which outputs are asked for at all, where that is known: a history is simulated to its last sample among them.

    Attributes:
        simulations: how many were made so far.
    """

    def __init__(
        self,
        model: AbstractModel,
        observation: Observation,
        names: tuple[str, ...],
        conditions: Conditions,
        parts: Sequence[Part] = (),
        used: Bool[np.ndarray, "n J"] | None = None,
    ):
        self._model, self._observation, self._names, self._conditions = model, observation, names, conditions
        self._of_effect = {part.effect: frozenset(part.columns.tolist()) for part in parts}
        self._columns = np.concatenate([np.zeros(0, dtype=int), *(part.columns for part in parts)]).astype(int)
        self._neutral = np.concatenate([np.zeros(0), *(part.neutral for part in parts)])
        self._steps = 1 if model.timeline is None else model.timeline.steps
        self._ends = None if used is None else _steps_to(used, conditions, observation, model)
        self._simplest = frozenset[int]().union(*(part.simplest for part in parts))
        self._programs = {has: self._program(has) for has in (frozenset[int](), self._simplest)}
        self._spent: Counter[Columns] = Counter()
        self._threads = ThreadPoolExecutor(cores())
        self.simulations = 0

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """Outputs (L, J) and whether each simulation converged (L,); outputs of one that diverged are zero.

        Arguments:
            thetas: parameters.
            experiments: their numbers.
            samples: of a history so many are asked for, by default all that are used; later ones are as the last.
        """
        self.simulations += len(thetas)
        stops = None
        if self._ends is not None:
            most = self._ends.shape[1] - 1
            stops = self._ends[experiments, most if samples is None else np.clip(samples + _AHEAD, 0, most)]
        served = [(*self._programs[has], places) for has, places in self._by_program(thetas).items()]
        if stops is not None:
            # What runs together stops together.
            served = [(*which, places[np.argsort(stops[places], kind="stable")]) for *which, places in served]
        # Tiles are shared among the cores.  The first chunk of each program comes before all others, so that programs are made
        # side by side.
        size = min(max(-(-len(thetas) // (cores() * _TILE)), 1) * _TILE, _CHUNK)
        chunks = [
            (outputs, columns, places[start : start + size])
            for start in range(0, len(thetas), size)
            for outputs, columns, places in served
            if start < len(places)
        ]

        def run(chunk: tuple[Outputs, np.ndarray, np.ndarray]):
            outputs, columns, places = chunk
            padding = ((0, _CHUNK - len(places)),)
            found, ok = _outputs(
                outputs,
                self._conditions,
                jnp.asarray(np.pad(thetas[places][:, columns], (*padding, (0, 0)), mode="edge")),
                jnp.asarray(np.pad(experiments[places], padding, mode="edge")),
                jnp.asarray(len(places)),
                None if stops is None else jnp.asarray(np.pad(stops[places], padding, mode="edge")),
            )
            return np.asarray(found)[: len(places)], np.asarray(ok)[: len(places)]

        found = list(self._threads.map(run, chunks))
        order = np.argsort(np.concatenate([places for _, _, places in chunks]))
        return np.concatenate([out for out, _ in found])[order], np.concatenate([ok for _, ok in found])[order]

    def _by_program(self, thetas: np.ndarray) -> dict[Columns, np.ndarray]:
        """The places of simulations by the program that they run."""
        is_needed = thetas[:, self._columns] != self._neutral
        kinds, kind_of = np.unique(is_needed, axis=0, return_inverse=True)
        needs = [frozenset(self._columns[kind].tolist()) for kind in kinds]
        self._provide(needs)
        by_program: dict[Columns, list[np.ndarray]] = {}
        for number, needed in enumerate(needs):
            places = np.flatnonzero(kind_of.ravel() == number)
            by_program.setdefault(self._serving(needed, len(places)), []).append(places)
        return {has: np.sort(np.concatenate(parts)) for has, parts in by_program.items()}

    def _provide(self, needs: Sequence[Columns]) -> None:
        """Make programs for what none has: of each set of effects whose shapes are not the simplest, all that is asked of it,
        with the simplest shapes of all others where it is asked beside several."""
        asked: dict[frozenset[str], list[Columns]] = {}
        for needed in needs:
            asked.setdefault(self._effects_of(needed - self._simplest), []).append(needed)
        # The largest first: that of a set serves its parts.
        for _, own in sorted(asked.items(), key=lambda item: -len(item[0])):
            missing = [needed for needed in own if not any(needed <= has for has in self._programs)]
            if missing:
                several = len({self._effects_of(needed) for needed in missing}) > 1
                has = frozenset[int]().union(*missing, self._simplest if several else ())
                self._programs[has] = self._program(has)

    def _effects_of(self, needed: Columns) -> frozenset[str]:
        """The effects that have these columns."""
        return frozenset(effect for effect, own in self._of_effect.items() if own & needed)

    def _serving(self, needed: Columns, simulations: int) -> Columns:
        """The smallest program with these parameters, after one of their own was made if that has become worth it."""
        there = min((has for has in self._programs if needed <= has), key=len)
        self._spent[needed] += simulations * self._steps * (len(there) - len(needed))
        if self._spent[needed] <= _PRICE:
            return there
        self._programs[needed] = self._program(needed)
        return needed

    def _program(self, has: Columns) -> tuple[Outputs, Int[np.ndarray, " p"]]:
        """The model with these parameters of effects only, and the columns of all its parameters."""
        lacking = set(self._columns.tolist()) - has
        columns = [k for k in range(len(self._names)) if k not in lacking]
        left_out = {effect for effect, own in self._of_effect.items() if not own & has}
        model = self._model
        if left_out:
            assert isinstance(model, Simulator)
            model = replace(model, effects=model.effects.only(e for e in model.effects if e not in left_out))
        outputs = Outputs(model, self._observation, tuple(self._names[k] for k in columns))
        return outputs, np.asarray(columns)


def _steps_to(
    used: Bool[np.ndarray, "n J"], conditions: Conditions, observation: Observation, model: AbstractModel
) -> Int[np.ndarray, "n s1"] | None:
    """Steps to the first 0, 1, 2, … samples of each experiment, at most to the last that is used; None where a simulation is not
    one of histories over a record."""
    recorded = conditions.recorded
    if not isinstance(observation, Histories) or recorded is None or model.timeline is None:
        return None
    count, steps, every = observation.samples, model.timeline.steps, model.timeline.every
    ends = every * np.arange(count) if recorded.ends is None else np.asarray(recorded.ends)
    ends = np.broadcast_to(ends, (len(used), count))
    is_used = used.reshape(len(used), -1, count).any(axis=1)
    # One that is not measured is asked for as a whole.
    last = np.where(is_used.any(axis=1), np.minimum(count - np.argmax(is_used[:, ::-1], axis=1) + _AHEAD, count), count)
    whole = np.minimum(ends, ends[np.arange(len(used)), last - 1][:, None])
    return np.minimum(np.concatenate([whole[:, :1], whole], axis=1), steps)


@program
def _outputs(respond, conditions, thetas, experiments, count, stops):
    def tile(lanes):
        thetas, experiments, stops = lanes
        # One number for all, or the loop would ask every lane at every step.
        stop = None if stops is None else jnp.max(stops)

        def one(theta, experiment):
            at_it = jax.tree.map(lambda leaf: leaf[experiment], conditions)
            if stop is not None:
                at_it = at_it._replace(recorded=at_it.recorded._replace(stop=stop))
            outputs, ok = respond(theta, at_it)
            # On its way to infinity a diverging simulation passes numbers whose squares are no numbers any more.
            ok = ok & jnp.all(jnp.abs(outputs) < _FAR)
            return jnp.where(ok, outputs, 0.0), ok

        return jax.vmap(one)(thetas, experiments)

    outputs, ok = tiled_map(tile, (thetas, experiments, stops), count=count, tile=_TILE)
    return outputs, ok.astype(float)
