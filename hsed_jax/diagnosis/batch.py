"""Simulations of many models in one batch; each simulation is a pair of a parameter vector and an experiment.

One program holds every candidate effect in all its forms.  It serves every set of effects, every campaign of the same kind and
every record of similar length, because masses, scales, data and parameters are operands.  An effect whose parameters are neutral
in all simulations that run together is not computed (`hsed_jax.physics.gates`).  Simulations of one model thus run together.

A model that is simulated often gets a separate program, which is faster.  It is compiled as soon as it would have saved the time
of its compilation (the ski-rental rule: at most twice the cost with a known number of simulations; Karlin et al. 1988).

Threads run chunks of simulations in parallel, because XLA runs a program of this kind on one core.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from hsed_jax.backend import cores
from hsed_jax.inference.observation import Histories, Observation, Outputs, first_alike
from hsed_jax.physics.batch import tiled_map
from hsed_jax.physics.gates import BATCH_AXIS, Acts
from hsed_jax.physics.simulator import AbstractModel, Conditions, Simulator
from hsed_jax.programs import program

# Simulations of a chunk, and of a tile, which run together: most rounds request few simulations of each set.
_CHUNK, _TILE = 64, 8
# A history is simulated for this many samples more than requested, because a sensor may be early.
_AHEAD = 16
# Larger outputs belong to a diverging simulation; their squares may overflow.
_FAR = 1e100
# The compilation of a separate program takes about three seconds, the time that it saves in this many steps.
_PRICE = 8_000_000


@runtime_checkable
class Predictions(Protocol):
    """Predicts the outputs of many models; `Batch` is one implementation."""

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """Outputs and whether each simulation converged.

        Arguments:
            thetas: parameters.
            experiments: numbers of the experiments.
            samples: requested samples of each history, by default all used ones; later samples may have any value.
        """
        ...


class Part(NamedTuple):
    """A candidate in the large model.

    Attributes:
        effect: the name of the effect.
        columns: indices of its parameters, (q,).
        neutral: neutral values of these parameters, (q,).
        shapes: whether each parameter changes the shape of the effect from its simplest shape, (q,).
    """

    effect: str
    columns: Int[np.ndarray, " q"]
    neutral: Float[np.ndarray, " q"]
    shapes: Bool[np.ndarray, " q"]


class Present(NamedTuple):
    """Determines from a parameter vector which effects it contains.

    Attributes:
        effects: names of the E effects.
        neutral: parameters at which all effects are absent, (P,).
        owned, shapes: whether a parameter belongs to an effect, and whether it is a shape parameter of the effect, (E, P).
    """

    effects: tuple[str, ...]
    neutral: Float[Array, " P"]
    owned: Bool[Array, "E P"]
    shapes: Bool[Array, "E P"]

    def acting(self, thetas: Float[Array, "L P"]) -> dict[str, Acts]:
        """The action of each effect in simulations that run together."""
        differs = jnp.any(thetas != self.neutral, axis=0)
        acts, is_shaped = (jnp.any(own & differs, axis=1) for own in (self.owned, self.shapes))
        return {name: Acts(acts[k], is_shaped[k]) for k, name in enumerate(self.effects)}


class Served(NamedTuple):
    """A program and its parameters.

    Attributes:
        outputs: the function that the program computes.
        present: determines the effects of a simulation; None if the program computes all its effects.
        columns: indices of its parameters in a full parameter vector, (p,).
    """

    outputs: Outputs
    present: Present | None
    columns: Int[np.ndarray, " p"]


class Apart(NamedTuple):
    """Differences of the parameters of each experiment from the common parameters: each specimen has its own parameters.

    Attributes:
        names: of the parameters.
        factor, shift: the factor multiplies each parameter, then the shift is added, (n, K).
    """

    names: tuple[str, ...]
    factor: Float[np.ndarray, "n K"]
    shift: Float[np.ndarray, "n K"]

    def across(self, names: tuple[str, ...], rows: int) -> "Apart":
        """The same for all parameters of a larger model and for more experiments, which have the common parameters."""
        factor, shift = np.ones((rows, len(names))), np.zeros((rows, len(names)))
        for k, name in enumerate(self.names):
            column = names.index(name)
            factor[: len(self.factor), column] = self.factor[:, k]
            shift[: len(self.shift), column] = self.shift[:, k]
        return Apart(names, factor, shift)


class BatchApart(NamedTuple):
    """A batch in which each experiment has its own parameters, relative to the requested ones."""

    batch: "Predictions"
    apart: Apart

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """As in `Batch`."""
        own = thetas * self.apart.factor[experiments] + self.apart.shift[experiments]
        return self.batch(own, experiments, samples)


class Selected(NamedTuple):
    """A batch of some of the experiments, numbered among themselves.

    Attributes:
        batch: of all experiments.
        rows: indices of the selected experiments among all experiments, (r,).
    """

    batch: "Predictions"
    rows: Int[np.ndarray, " r"]

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """As in `Batch`."""
        return self.batch(thetas, self.rows[experiments], samples)


class Batch:
    """Outputs of a model for many simulations; each is a parameter vector and the number of an experiment.

    Arguments:
        model: the computational model.
        observation: selects the predicted outputs of a response.
        names: of the parameters, in the order of a parameter vector.
        conditions: of the experiments, leading axis n.
        parts: the effects of a `Simulator` that may be absent in a simulation.
        used: whether each output is ever requested, if known: a history is simulated to the last of these samples.
        kept: indices of the returned outputs, K of them; by default all.

    Attributes:
        simulations: the number of simulations so far.
    """

    def __init__(
        self,
        model: AbstractModel,
        observation: Observation,
        names: tuple[str, ...],
        conditions: Conditions,
        parts: Sequence[Part] = (),
        used: Bool[np.ndarray, "n J"] | None = None,
        kept: Int[np.ndarray, " K"] | None = None,
    ):
        self._kept = slice(None) if kept is None else kept
        self._outputs, self._conditions = Outputs(model, observation, names), conditions
        self._present = _present(parts, len(names)) if parts else None
        self._first = first_alike(conditions)
        self._ends = None if used is None else _steps_to(used, conditions, observation, model)
        self._steps = 1 if model.timeline is None else model.timeline.steps
        self._spent: Counter[bytes] = Counter()
        self._own: dict[bytes, Served] = {}
        self._threads = ThreadPoolExecutor(cores())
        self.simulations = 0

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L K"], Float[np.ndarray, " L"]]:
        """Outputs (L, K) and whether each simulation converged (L,); the outputs of a diverged simulation are zero.

        Arguments:
            thetas: parameters.
            experiments: numbers of the experiments; windows of one record are simulated once.
            samples: requested samples of each history, by default all used ones; later samples may have any value.
        """
        stops = None
        if self._ends is not None:
            most = self._ends.shape[1] - 1
            stops = self._ends[experiments, most if samples is None else np.clip(samples + _AHEAD, 0, most)]
        alike = self._first[experiments]
        if (alike == experiments).all():
            return self._simulated(thetas, experiments, stops)
        # The pairs of a parameter vector and a record, in the order in which they first occur.
        pairs: dict[tuple[bytes, int], int] = {}
        keys = zip(map(bytes, thetas), alike.tolist(), strict=True)
        place = np.asarray([pairs.setdefault(key, len(pairs)) for key in keys], dtype=int)
        rows = np.unique(place, return_index=True)[1]
        if stops is not None:
            longest = np.zeros(len(rows), dtype=stops.dtype)
            np.maximum.at(longest, place, stops)
            stops = longest
        outputs, ok = self._simulated(thetas[rows], alike[rows], stops)
        return outputs[place], ok[place]

    def _simulated(
        self, thetas: np.ndarray, experiments: np.ndarray, stops: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same for simulations that differ from one another, each up to its stop."""
        self.simulations += len(thetas)
        # Every core gets the same number of chunks.
        count = cores() * max(-(-len(thetas) // (cores() * _CHUNK)), 1)
        size = -(-len(thetas) // (count * _TILE)) * _TILE
        chunks = [
            (served, places[start : start + size])
            for served, places in self._served(thetas, stops)
            for start in range(0, len(places), size)
        ]

        def run(chunk: tuple[Served, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
            (outputs, present, columns), places = chunk
            filled = places[np.minimum(np.arange(_CHUNK), len(places) - 1)]
            found, ok = _outputs(
                outputs,
                self._conditions,
                present,
                thetas[filled][:, columns],
                experiments[filled],
                np.asarray(len(places)),
                None if stops is None else stops[filled],
            )
            return np.asarray(found)[: len(places), self._kept], np.asarray(ok)[: len(places)]

        found = list(self._threads.map(run, chunks))
        back = np.argsort(np.concatenate([places for _, places in chunks]))
        return np.concatenate([out for out, _ in found])[back], np.concatenate([ok for _, ok in found])[back]

    def _served(self, thetas: np.ndarray, stops: np.ndarray | None) -> Iterator[tuple[Served, np.ndarray]]:
        """The programs, and the indices of their simulations in the order of execution: the simulations of one model run
        together, sorted by length."""
        lengths = np.full(len(thetas), self._steps) if stops is None else stops
        kind_of, is_alone = np.zeros(len(thetas), dtype=int), np.zeros(len(thetas), dtype=bool)
        if self._present is not None:
            # Each row becomes one value: sorting the rows by their columns takes ten times as long.
            which = thetas != np.asarray(self._present.neutral)
            bits = np.packbits(which, axis=1)
            _, firsts, kind_of = np.unique(
                bits.view(f"V{bits.shape[1]}").ravel(), return_index=True, return_inverse=True
            )
            for number, differs in enumerate(which[firsts]):
                places, key = np.flatnonzero(kind_of == number), differs.tobytes()
                self._spent[key] += int(lengths[places].sum())
                if self._spent[key] > _PRICE:
                    if key not in self._own:
                        self._own[key] = self._alone(differs)
                    is_alone[places] = True
                    yield self._own[key], places[np.argsort(lengths[places], kind="stable")]
        rest = np.flatnonzero(~is_alone)
        if rest.size:
            order = np.lexsort([lengths[rest], kind_of[rest]])
            yield Served(self._outputs, self._present, np.arange(thetas.shape[1])), rest[order]

    def _alone(self, differs: Bool[np.ndarray, " P"]) -> Served:
        """A program for the model in which only these effect parameters are not neutral; the others are compiled constants."""
        assert self._present is not None
        owned = np.asarray(self._present.owned)
        absent = {name for name, own in zip(self._present.effects, owned, strict=True) if not differs[own].any()}
        columns = np.flatnonzero(differs | ~owned.any(axis=0))
        model = self._outputs.model
        assert isinstance(model, Simulator)
        lean = replace(model, effects=model.effects.only(e for e in model.effects if e not in absent))
        names = tuple(self._outputs.names[k] for k in columns)
        return Served(Outputs(lean, self._outputs.observation, names), None, columns)


def _present(parts: Sequence[Part], count: int) -> Present:
    neutral, owned = np.zeros(count), np.zeros((len(parts), count), dtype=bool)
    shapes = np.zeros_like(owned)
    for row, part in enumerate(parts):
        neutral[part.columns], owned[row, part.columns], shapes[row, part.columns] = part.neutral, True, part.shapes
    return Present(tuple(part.effect for part in parts), jnp.asarray(neutral), jnp.asarray(owned), jnp.asarray(shapes))


def _steps_to(
    used: Bool[np.ndarray, "n J"], conditions: Conditions, observation: Observation, model: AbstractModel
) -> Int[np.ndarray, "n s1"] | None:
    """Steps to the first 0, 1, 2, … samples of each experiment, limited by the last used sample and by the end of its record;
    None if the simulations give no histories over a record."""
    recorded = conditions.recorded
    if not isinstance(observation, Histories) or recorded is None or model.timeline is None:
        return None
    count, steps, every = observation.samples, model.timeline.steps, model.timeline.every
    ends = every * np.arange(count) if recorded.ends is None else np.asarray(recorded.ends)
    ends = np.broadcast_to(ends, (len(used), count))
    is_used = used.reshape(len(used), -1, count).any(axis=1)
    # An experiment without measurements is simulated as a whole.
    last = np.where(is_used.any(axis=1), np.minimum(count - np.argmax(is_used[:, ::-1], axis=1) + _AHEAD, count), count)
    whole = np.minimum(ends, ends[np.arange(len(used)), last - 1][:, None])
    # Padded samples are at the last step of the program, after the record.
    ended = np.full(len(used), steps) if recorded.stop is None else np.broadcast_to(recorded.stop, len(used))
    return np.minimum(np.concatenate([whole[:, :1], whole], axis=1), ended[:, None])


@program
def _outputs(
    respond: Outputs,
    conditions: Conditions,
    present: Present | None,
    thetas: ArrayLike,
    experiments: ArrayLike,
    count: ArrayLike,
    stops: ArrayLike | None,
) -> tuple[Array, Array]:
    def tile(batch: tuple[Array, Array, Array | None]) -> tuple[Array, Array]:
        thetas, experiments, stops = batch
        if stops is None and conditions.stop is not None:
            stops = conditions.stop[experiments]
        # One number for all simulations: otherwise the loop tests every simulation at every step.
        stop = None if stops is None else jnp.max(stops)
        acting, records = None if present is None else present.acting(thetas), conditions.until(None)

        def one(theta: Array, experiment: Array) -> tuple[Array, Array]:
            of_one: Callable[[Array], Array] = lambda leaf: leaf[experiment]  # noqa: E731
            at_it = jax.tree.map(of_one, records)._replace(acting=acting)
            outputs, ok = respond(theta, at_it.until(stop))
            # Before a diverging simulation reaches infinity, its outputs are so large that their squares overflow.
            ok = ok & jnp.all(jnp.abs(outputs) < _FAR)
            return jnp.where(ok, outputs, 0.0), ok

        return jax.vmap(one, axis_name=BATCH_AXIS)(thetas, experiments)

    lanes = jnp.asarray(thetas), jnp.asarray(experiments), None if stops is None else jnp.asarray(stops)
    outputs, ok = tiled_map(tile, lanes, count=count, tile=_TILE)
    return outputs, ok.astype(float)
