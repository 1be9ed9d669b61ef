r"""The loading of a component test that separates several explanations best.

A component test has no inputs to choose, but a laboratory chooses the sequence of its amplitudes.  The candidates are the
measured test itself, published protocols and simple sequences.  None has a larger elongation or a longer path than the measured
test, so that none needs more stroke or causes more damage.  Each is imposed on a virgin specimen, at the rate of the test and, if
the record has a time, at a tenth of it.

Each explanation predicts the force of every candidate.  The first candidate with nearly the largest expected log Bayes factor
between the explanations (`hsed_jax.diagnosis.rivals`) is proposed.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import cycle, islice
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from hsed_jax.behaviour.histories import Range, imposed, largest_changes
from hsed_jax.diagnosis.fits import Model
from hsed_jax.diagnosis.probing import Probe
from hsed_jax.diagnosis.rivals import (
    WORTHWHILE,
    Predictive,
    around,
    expected_log_bayes_factor,
    spread_of,
)
from hsed_jax.diagnosis.search import Search
from hsed_jax.physics import display
from hsed_jax.physics.pairs import Pair
from hsed_jax.physics.protocols import PROTOCOLS

# Number of samples of the force, at equal steps of the path, and largest number of reversals of a candidate.
_SAMPLES, _REVERSALS = 200, 80
# The first candidate with this share of the largest expectation is proposed; the measured test and fast loadings come first.
_NEARLY = 0.9
# The steps are this many times longer than those of the behaviour.
_COARSER = 2.0
# Rates, relative to that of the test.
_RATES = (1.0, 0.1)
_REPEATED = "the same test again"
# Amplitudes of the cycles, relative to the largest elongation, in order; a sequence is repeated, a protocol is not.
_SEQUENCES = {
    "cycles of constant amplitude": (1.0,),
    "cycles of half the amplitude": (0.5,),
    "cycles of growing amplitude": tuple(np.repeat(np.arange(1, 9) / 8, 2)),
    "cycles of falling amplitude": tuple(np.repeat(np.arange(8, 0, -1) / 8, 2)),
    "large and small cycles in turn": (1.0, 0.25),
    "small cycles with a large one after each three": (0.25, 0.25, 0.25, 1.0),
}


class Loading(NamedTuple):
    """A proposed loading.

    Attributes:
        name: in words.
        reversals: elongations at the reversals, in order, for a virgin specimen [m].
        rate: of the elongation [m/s]; None if the test has no time.
        expected_log_bayes_factor: between the explanations [nats].
        repeated: expected log Bayes factor of the measured test, if it is repeated [nats].
        pair: the pair of quantities in which the specimen is measured.
    """

    name: str
    reversals: Float[np.ndarray, " r"]
    rate: float | None
    expected_log_bayes_factor: float
    repeated: float
    pair: Pair

    def summary(self) -> dict[str, Any]:
        """The key `diagnosis.next_loading` of `summary.json`."""
        return {
            "name": self.name,
            "reversals": [float(f"{u:.4g}") for u in self.reversals],
            "rate": self.rate,
            "unit": self.pair.unit("m"),
            "expected_log_bayes_factor": self.expected_log_bayes_factor,
            "repeated": self.repeated,
        }

    @property
    def sentence(self) -> str:
        """The loading and its expected log Bayes factor."""
        divisor, unit = display.shown_in(self.pair, "m", self.reversals)
        first = ", ".join(f"{u / divisor:.3g}" for u in self.reversals[:6])
        return (
            f"the loading that separates them best on a new specimen is {self.name}: reversals at {first}, ... {unit}; its "
            f"expected log Bayes factor is {self.expected_log_bayes_factor:.2g} nats, and that of the same test again is "
            f"{self.repeated:.2g} nats"
        )


def next_loading(probe: Probe, search: Search, rivals: Sequence[Model]) -> Loading | None:
    """The loading that separates explanations best; None if none is expected to separate them, if the measured test separates
    them nearly as well, or if no force is measured.

    Arguments:
        probe: numerical experiments on the problem, which is a component test.
        search: the search, which has ended.
        rivals: the explanations.
    """
    problem, visited, element = probe.problem, probe.visited, probe.simulator.elements[0]
    if "force" not in problem.outputs:
        return None
    sequences = [*_sequences(visited)]
    step = _COARSER * probe.step(probe.fitted(rivals[0]), element)
    histories = imposed([turns for _, turns, _ in sequences], [rate for _, _, rate in sequences], step)
    samples = _evenly(histories.elongation[:, ::2])
    predictions: list[Predictive] = []
    for model in rivals:
        near = around(problem.models, model.fit)
        thetas = [problem.models.theta(x, model.fit.submodel) for x in near.points]
        found = probe.forces(model, thetas, element, histories)
        force = np.take_along_axis(found.force, samples[None], axis=2)
        ok = found.ok.astype(float)
        predictions.append(Predictive(force[0], spread_of(near, force, ok), ok[0]))
    group = problem.outputs.index("force")
    magnitude = np.sqrt(np.mean(predictions[0].mean ** 2, axis=1, keepdims=True))
    size = magnitude if problem.train.errors[group].is_relative else 1.0
    root = np.broadcast_to(
        np.sqrt(search.standard.worth[group]) / (search.standard.errors[group] * size), samples.shape
    )
    # The verdict states that the explanations are equally good, so they have equal probabilities.
    information = expected_log_bayes_factor(predictions, root, np.full(len(rivals), 1 / len(rivals)))
    best = int(np.argmax(information >= _NEARLY * information.max()))
    name, turns, rate = sequences[best]
    if not information[best] > WORTHWHILE or name == _REPEATED:
        return None
    asked = rate if visited.has_time else None
    return Loading(name, turns[1:], asked, float(information[best]), float(information[0]), problem.pair)


def _sequences(visited: Range) -> Iterator[tuple[str, Float[np.ndarray, " r"], float]]:
    """Names, reversals from zero on [m] and rates [m/s] of the candidates; the measured test is the first one."""
    many = _REVERSALS // 2
    shapes = {name: _within_path(islice(cycle(shares), many), visited) for name, shares in _SEQUENCES.items()}
    for protocol in PROTOCOLS.values():
        shares = np.asarray(protocol.amplitudes()) / max(protocol.amplitudes(), default=1.0)
        turns = _within_path(shares, visited)
        # A protocol that does not fit into the path of the test is omitted: a part of it is another loading.
        if len(turns) == 1 + 2 * len(shares) > 1:
            shapes[f"the protocol {protocol.title}"] = turns
    for rate in _RATES if visited.has_time else _RATES[:1]:
        slowly = "" if rate == 1 else f", {1 / rate:.0f} times slower"
        for name, turns in {_REPEATED: largest_changes(visited.turns, _REVERSALS), **shapes}.items():
            yield name + slowly, turns, rate * visited.rate


def _within_path(shares: Iterable[float], visited: Range) -> Float[np.ndarray, " r"]:
    """Reversals of cycles of both signs, from zero on [m], up to the path of the test; shares are of its largest elongation."""
    turns = visited.elongation * np.asarray([0.0, *(side * share for share in shares for side in (1.0, -1.0))])
    passed = np.cumsum(np.abs(np.diff(turns, prepend=0.0)))
    return turns[passed <= visited.path * (1 + 1e-9)]


def _evenly(elongation: Float[np.ndarray, "c n"]) -> Int[np.ndarray, "c samples"]:
    """Indices of samples at equal steps of the path."""
    passed = np.cumsum(np.abs(np.diff(elongation, axis=1, prepend=elongation[:, :1])), axis=1)
    shares = np.linspace(0, 1, _SAMPLES + 1)[1:]
    found = np.zeros((len(passed), _SAMPLES), dtype=int)
    for k in range(len(passed)):
        found[k] = np.searchsorted(passed[k], shares * passed[k, -1])
    return np.minimum(found, passed.shape[1] - 1)
