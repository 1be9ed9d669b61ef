"""The points of a sweep: the keys of a study with their values, checked so that every study can run."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.stats import qmc

from hsed_jax.config.load import load_study
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.measurements import stop_at_errors
from hsed_jax.memory import check_memory
from hsed_jax.study import parts
from hsed_jax.study.build import Built

# A point and its study, as objects [bytes].
_POINT = 1000
Point = Mapping[str, Any]
"""Values by dotted path, such as {"design.initial": 4}."""
Range = Sequence[float] | Mapping[str, Any]
"""Low and high, or a distribution as a study has them, such as {"loguniform": [1e-3, 1e-1]}."""


@dataclass(frozen=True)
class Plan:
    """The studies of a sweep.

    Attributes:
        study: the study that all points have in common, every default written out.
        points: the changed keys of each.
    """

    study: dict[str, Any]
    points: tuple[dict[str, Any], ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """Every swept key, in order."""
        return tuple(dict.fromkeys(key for point in self.points for key in point))

    def studies(self) -> list[Study]:
        """The study of every point.

        Raises:
            UserError: one is wrong; names the point.
        """
        return [self._study(number) for number in range(len(self.points))]

    def check(self) -> None:
        """Check every study as `hsed check` does, before any runs.

        Raises:
            UserError: one is wrong; names the point.
        """
        campaigns, brought = {}, set()
        for number, study in enumerate(self.studies()):
            values = {(key, json.dumps(value)) for key, value in self.points[number].items()}
            # Building takes up to half a second: a point of a grid is built only if it has a new value.
            if values <= brought:
                continue
            brought |= values
            where = study.experiments.campaign
            try:
                built = Built(study, campaigns.get(where))
                # Points usually share the measurements, and reading them takes the longest time.
                campaigns[where] = built.experiments.measured
                if (measured := built.experiments.measured) is not None:
                    stop_at_errors(measured, study.measurements.accepted(measured), study.needs_loops)
                built.check()
            except UserError as error:
                raise UserError(f"{self._about(number)}: {error}") from None

    def _study(self, number: int) -> Study:
        # JSON is YAML, and has every number to the last bit.
        overrides = [f"{key}={json.dumps(value)}" for key, value in self.points[number].items()]
        try:
            return load_study(self.study, overrides)
        except UserError as error:
            raise UserError(f"{self._about(number)}: {str(error).removeprefix('study: ')}") from None

    def _about(self, number: int) -> str:
        return f"point {number + 1} of {len(self.points)} ({described(self.points[number])})"


def described(point: Point) -> str:
    """A point in running text: `seed = 1, error.relative = 0.05`."""
    return ", ".join(f"{key} = {json.dumps(value)}" for key, value in point.items())


def plan_of(
    study: Study,
    values: Mapping[str, Sequence[Any]],
    points: Sequence[Point],
    ranges: Mapping[str, Range],
    samples: int | None,
) -> Plan:
    """The product of a grid of values, listed points and sampled ranges, as far as they are given.

    Arguments:
        study: common to all points.
        values: lists of values by key.
        points: points as they are.
        ranges: ranges by key that are sampled.
        samples: how many samples to draw, by Latin hypercube.

    Raises:
        UserError: nothing is swept, a key or a point stands twice, a list is empty, ranges come without samples.
    """
    sources: list[list[dict[str, Any]]] = []
    for key, given in values.items():
        if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray) or not len(given):
            raise UserError(f"{key}: give a list of values to sweep over")
        sources.append([{key: _plain(value)} for value in given])
    if points:
        sources.append([_point(point) for point in points])
    if ranges or samples is not None:
        sources.append(_sampled(ranges, samples, study.seed))
    if not sources:
        raise UserError("nothing is swept; give a key and its values, such as --set seed=0,1,2")
    taken: set[str] = set()
    for source in sources:
        own = {key for point in source for key in point}
        if twice := sorted(own & taken):
            raise UserError(f"{twice[0]}: this key is swept twice")
        taken |= own
    for key in sorted(taken):
        if inner := [other for other in sorted(taken) if other.startswith(f"{key}.")]:
            raise UserError(f"{inner[0]}: this key is a part of {key}, which is swept, too; sweep one of them")
    if "study" in taken:
        raise UserError("study: the name of a study cannot be swept")
    found = [{key: value for part in parts for key, value in part.items()} for parts in product(*sources)]
    seen: dict[str, int] = {}
    for number, point in enumerate(found):
        first = seen.setdefault(json.dumps(point, sort_keys=True), number)
        if first != number:
            raise UserError(f"points {first + 1} and {number + 1} are the same: {described(point)}")
    return Plan(study.written(), tuple(found))


def _point(point: Any) -> dict[str, Any]:
    if not isinstance(point, Mapping) or not point:
        raise UserError(f"a point is a mapping of keys to values, such as {{seed: 1}}, but one is {point!r}")
    return {str(key): _plain(value) for key, value in point.items()}


def _sampled(ranges: Mapping[str, Range], samples: int | None, seed: int) -> list[dict[str, Any]]:
    if not ranges:
        raise UserError("samples need at least one range to be drawn from, such as --range error.relative=0.01,0.1")
    if samples is None or samples < 1:
        raise UserError("ranges are sampled; give the number of samples, such as --samples 20")
    check_memory(f"samples: {samples}", samples * _POINT)
    columns = []
    cube = qmc.LatinHypercube(len(ranges), rng=seed).random(samples)
    for (key, given), shares in zip(ranges.items(), cube.T, strict=True):
        prior = parts.prior(key, dict(given) if isinstance(given, Mapping) else {"uniform": list(given)})
        columns.append(np.asarray(prior.quantile(shares)).tolist())
    return [dict(zip(ranges, row, strict=True)) for row in zip(*columns, strict=True)]


def _plain(value: Any) -> Any:
    """A value for YAML: numbers and arrays of NumPy, and tuples, as numbers and lists."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
