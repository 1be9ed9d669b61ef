"""Simulations of many models in one batch: pairs of a parameter vector and an experiment.

One program holds every candidate effect in all its forms.  It serves every set of effects, every campaign of its kind and every
record of about its length: masses, scales, data and parameters are operands.  An effect whose parameters are neutral in all
simulations that run together is not computed (`hsed_jax.physics.gates`), so simulations of one model run together.

A model that is simulated again and again gets a program of its own, which is faster, as soon as that would have paid for
itself (the rule of ski rental: at most twice the cost of knowing the number of simulations beforehand; Karlin et al. 1988).

Chunks of simulations go to threads: XLA runs a program of this kind on one core, and several at a time on several.
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
from jaxtyping import Array, Bool, Float, Int

from hsed_jax.backend import cores
from hsed_jax.inference.observation import Histories, Observation, Outputs
from hsed_jax.physics.batch import tiled_map
from hsed_jax.physics.gates import BATCH_AXIS, Acts
from hsed_jax.physics.simulator import AbstractModel, Conditions, Simulator
from hsed_jax.programs import program

# Simulations of a chunk, and those that run together: most rounds ask for a few of each set.
_CHUNK, _TILE = 64, 8
# So many samples more than are asked for: a sensor may be early.
_AHEAD = 16
# Outputs beyond this are on their way to infinity, and their squares would be no numbers.
_FAR = 1e100
# A program of its own takes about three seconds to make, as long as it saves in so many steps.
_PRICE = 8_000_000


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


class Part(NamedTuple):
    """A candidate in the large model.

    Attributes:
        effect: its name.
        columns: of its parameters, (q,).
        neutral: what these are where it is absent, (q,).
        shapes: whether each tells a shape of the effect from the simplest one, (q,).
    """

    effect: str
    columns: Int[np.ndarray, " q"]
    neutral: Float[np.ndarray, " q"]
    shapes: Bool[np.ndarray, " q"]


class Present(NamedTuple):
    """What tells from a parameter vector which effects it has.

    Attributes:
        effects: their names, E of them.
        neutral: parameters where all are absent, (P,).
        owned, shapes: whether a parameter belongs to an effect, and whether it is one of its shape, (E, P).
    """

    effects: tuple[str, ...]
    neutral: Float[Array, " P"]
    owned: Bool[Array, "E P"]
    shapes: Bool[Array, "E P"]

    def acting(self, thetas: Float[Array, "L P"]) -> dict[str, Acts]:
        """What each effect does in any of several simulations."""
        differs = jnp.any(thetas != self.neutral, axis=0)
        acts, is_shaped = (jnp.any(own & differs, axis=1) for own in (self.owned, self.shapes))
        return {name: Acts(acts[k], is_shaped[k]) for k, name in enumerate(self.effects)}


class Served(NamedTuple):
    """A program, and what of a parameter vector it takes.

    Attributes:
        outputs: what it computes.
        present: which effects a simulation has; None where it computes all that there are.
        columns: of the parameters, (p,).
    """

    outputs: Outputs
    present: Present | None
    columns: Int[np.ndarray, " p"]


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
        kept: the outputs that are returned, K of them; by default all.

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
        kept: Int[np.ndarray, " K"] | None = None,
    ):
        self._kept = slice(None) if kept is None else kept
        self._outputs, self._conditions = Outputs(model, observation, names), conditions
        self._present = _present(parts, len(names)) if parts else None
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
        """Outputs (L, K) and whether each simulation converged (L,); outputs of one that diverged are zero.

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
        # Tiles are shared among the cores.
        size = min(max(-(-len(thetas) // (cores() * _TILE)), 1) * _TILE, _CHUNK)
        chunks = [
            (served, places[start : start + size])
            for served, places in self._served(thetas, stops)
            for start in range(0, len(places), size)
        ]

        def run(chunk: tuple[Served, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
            (outputs, present, columns), places = chunk
            padding = ((0, _CHUNK - len(places)),)
            found, ok = _outputs(
                outputs,
                self._conditions,
                present,
                jnp.asarray(np.pad(thetas[places][:, columns], (*padding, (0, 0)), mode="edge")),
                jnp.asarray(np.pad(experiments[places], padding, mode="edge")),
                jnp.asarray(len(places)),
                None if stops is None else jnp.asarray(np.pad(stops[places], padding, mode="edge")),
            )
            return np.asarray(found)[: len(places), self._kept], np.asarray(ok)[: len(places)]

        found = list(self._threads.map(run, chunks))
        back = np.argsort(np.concatenate([places for _, places in chunks]))
        return np.concatenate([out for out, _ in found])[back], np.concatenate([ok for _, ok in found])[back]

    def _served(self, thetas: np.ndarray, stops: np.ndarray | None) -> Iterator[tuple[Served, np.ndarray]]:
        """The programs that simulations run, and the places of these in the order in which they run: those of one model together,
        and of these those of about one length."""
        lengths = np.full(len(thetas), self._steps) if stops is None else stops
        kind_of, is_alone = np.zeros(len(thetas), dtype=int), np.zeros(len(thetas), dtype=bool)
        if self._present is not None:
            # As one value a row: to sort rows by their columns takes ten times as long.
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
        """A program of the model in which these parameters are not neutral: all others are numbers that the compiler knows."""
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
    """Steps to the first 0, 1, 2, … samples of each experiment, at most to the last that is used and to the end of its record;
    None where a simulation is not one of histories over a record."""
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
    # Padded samples stand at the last step of the program, after the record.
    ended = np.full(len(used), steps) if recorded.stop is None else np.broadcast_to(recorded.stop, len(used))
    return np.minimum(np.concatenate([whole[:, :1], whole], axis=1), ended[:, None])


@program
def _outputs(
    respond: Outputs,
    conditions: Conditions,
    present: Present | None,
    thetas: Array,
    experiments: Array,
    count: Array,
    stops: Array | None,
) -> tuple[Array, Array]:
    def tile(batch: tuple[Array, Array, Array | None]) -> tuple[Array, Array]:
        thetas, experiments, stops = batch
        if stops is None and conditions.stop is not None:
            stops = conditions.stop[experiments]
        # One number for all, or the loop would ask every simulation at every step.
        stop = None if stops is None else jnp.max(stops)
        acting, records = None if present is None else present.acting(thetas), conditions.until(None)

        def one(theta: Array, experiment: Array) -> tuple[Array, Array]:
            of_one: Callable[[Array], Array] = lambda leaf: leaf[experiment]  # noqa: E731
            at_it = jax.tree.map(of_one, records)._replace(acting=acting)
            outputs, ok = respond(theta, at_it.until(stop))
            # On its way to infinity a diverging simulation passes numbers whose squares are no numbers any more.
            ok = ok & jnp.all(jnp.abs(outputs) < _FAR)
            return jnp.where(ok, outputs, 0.0), ok

        return jax.vmap(one, axis_name=BATCH_AXIS)(thetas, experiments)

    outputs, ok = tiled_map(tile, (thetas, experiments, stops), count=count, tile=_TILE)
    return outputs, ok.astype(float)
