r"""A plain function that JAX cannot trace, in a form that JAX can call and differentiate: by central differences.

The step of a parameter is a share of its prior's spread, or of its distance to a bound if that is smaller:
$h = 10^{-3}\,\min(\sigma, d)$.  The output of the function must then be accurate to about six digits; smaller errors of a
simulation are harmless.
"""

import logging
from collections import OrderedDict
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from threading import Lock
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.models.function import Respond, outputs_of
from hsed_jax.physics.outputs import is_quantity

_LOG = logging.getLogger(__name__)
_SHARE, _LEAST = 1e-3, 1e-3
# Results are cached: a search needs the value before the derivatives at the same point, and padding repeats the last
# call.
_KEPT = 4096


class Free(NamedTuple):
    """A parameter that is differentiated: its name, the spread of its prior, and its bounds."""

    name: str
    spread: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Differenced:
    """A plain function, or a program, as a function that JAX can call: values and differences are computed outside of it.

    Two objects of one function are equal, so that they share compiled programs.  A call that fails is a failure of that
    simulation (its outputs are NaN), and the first failure is written to the log.

    Attributes:
        function: of floats and NumPy arrays; it gets only the times of the record.
        name: of the function, for messages.
        outputs: the quantities and channels that it returns.
        free: the parameters to differentiate with respect to.
        workers: calls at a time.
    """

    function: Respond
    name: str
    outputs: tuple[str, ...]
    free: tuple[Free, ...]
    workers: int = 1
    _kept: OrderedDict[bytes, np.ndarray] = field(default_factory=OrderedDict, init=False, compare=False, repr=False)
    _lock: Any = field(default_factory=Lock, init=False, compare=False, repr=False)
    _told: list[str] = field(default_factory=list, init=False, compare=False, repr=False)

    def __call__(self, parameters: Mapping[str, Any], inputs: Mapping[str, Any]) -> dict[str, Any]:
        """The outputs by name; every free parameter must be there."""
        names = [free.name for free in self.free]
        theta = jnp.stack([jnp.asarray(parameters[name], dtype=float) for name in names])
        fixed = tuple((name, float(value)) for name, value in parameters.items() if name not in names)
        known = {name: jnp.asarray(value, dtype=float) for name, value in inputs.items()}
        flat = _called(_Call(self, fixed), theta, known)
        samples = known["time"].shape[0] if "time" in known else 0
        found, at = {}, 0
        for name in self.outputs:
            size = 1 if is_quantity(name) else samples
            found[name] = flat[at] if is_quantity(name) else flat[at : at + size]
            at += size
        return found

    def many(self, tasks: list[tuple[dict[str, float], dict[str, Any]]]) -> list[np.ndarray]:
        """The outputs of some calls, one after the other, each (J,), with the padding of short records restored."""
        if self.workers == 1:
            return [self._one(*task) for task in tasks]
        with ThreadPoolExecutor(self.workers) as threads:
            return list(threads.map(lambda task: self._one(*task), tasks))

    def _one(self, parameters: dict[str, float], inputs: dict[str, Any]) -> np.ndarray:
        key = np.concatenate([list(parameters.values()), *(np.ravel(value) for value in inputs.values())]).tobytes()
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        found = self._computed(parameters, inputs)
        with self._lock:
            self._kept[key] = found
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return found

    def _computed(self, parameters: dict[str, float], inputs: dict[str, Any]) -> np.ndarray:
        given = unpadded(inputs)
        samples, length = (known["time"].size if "time" in known else 0 for known in (inputs, given))
        try:
            found = outputs_of(self.function(parameters, given), given.get("time"), self.outputs)
        except (Exception, SystemExit) as error:
            self._tell(error)
            sizes = [1 if is_quantity(name) else samples for name in self.outputs]
            return np.full(sum(sizes), np.nan)
        columns = [
            np.ravel(found[name]) if is_quantity(name) else np.pad(found[name], (0, samples - length), mode="edge")
            for name in self.outputs
        ]
        return np.concatenate(columns)

    def _tell(self, error: BaseException) -> None:
        """Log the first failure; the others count in the same way."""
        with self._lock:
            if self._told:
                return
            self._told.append(failure(error))
        _LOG.warning("the model %s failed, which counts as a simulation that diverged: %s", self.name, self._told[0])


def unpadded(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """The histories of an experiment for a plain function, without the constant padding of a short record."""
    if "time" not in inputs:
        return dict(inputs)
    length = 2 + int(np.max(np.nonzero(np.diff(inputs["time"]))[0], initial=-1))
    return {name: value[:length] if np.ndim(value) else value for name, value in inputs.items()}


def failure(error: BaseException) -> str:
    """The error of a function, in a sentence."""
    return str(error) if isinstance(error, UserError | ExperimentFailed) else f"{type(error).__name__}: {error}"


@dataclass(frozen=True)
class _Call:
    """A differenced function at fixed values of some of its parameters: over a batch, as JAX calls it."""

    of: Differenced
    fixed: tuple[tuple[str, float], ...]

    def size(self, inputs: Mapping[str, Any]) -> int:
        """Number of columns, J."""
        samples = inputs["time"].shape[-1] if "time" in inputs else 0
        return sum(1 if is_quantity(name) else samples for name in self.of.outputs)

    def values(self, theta: Any, inputs: Mapping[str, Any]) -> np.ndarray:
        """(…, J) from parameters (…, p) and inputs, all with the same axes in front."""
        batch = self._batch(theta, inputs)
        return np.stack(self.of.many([self._task(*simulation) for simulation in batch])).reshape(
            *np.shape(theta)[:-1], -1
        )

    def expansion(self, theta: Any, inputs: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Values (…, J) and their derivatives (…, J, p)."""
        batch, axes = self._batch(theta, inputs), np.shape(theta)[:-1]
        points = [self._around(at) for at, _ in batch]
        tasks = [self._task(x, known) for around, (_, known) in zip(points, batch, strict=True) for x in around]
        found = np.stack(self.of.many(tasks)).reshape(len(batch), -1, self.size(inputs))
        slopes = np.stack([_slopes(x, f) for x, f in zip(points, found, strict=True)])
        return found[:, 0].reshape(*axes, -1), slopes.reshape(*axes, *slopes.shape[1:])

    def _batch(self, theta: Any, inputs: Mapping[str, Any]) -> list[tuple[np.ndarray, dict[str, Any]]]:
        axes = np.ndim(theta) - 1
        rows = np.asarray(theta).reshape(-1, np.shape(theta)[-1])
        known = {name: np.asarray(value) for name, value in inputs.items()}
        flat = {name: value.reshape(len(rows), *value.shape[axes:]) for name, value in known.items()}
        return [
            (row, {name: v[i] if v[i].ndim else float(v[i]) for name, v in flat.items()}) for i, row in enumerate(rows)
        ]

    def _task(self, at: np.ndarray, known: dict[str, Any]) -> tuple[dict[str, float], dict[str, Any]]:
        names = (free.name for free in self.of.free)
        return {**dict(zip(names, at.tolist(), strict=True)), **dict(self.fixed)}, known

    def _around(self, at: np.ndarray) -> np.ndarray:
        """The point, and for each parameter the one below it and the one above, (1 + 2p, p); within the bounds."""
        points = np.tile(at, (1 + 2 * at.size, 1))
        for k, (free, x) in enumerate(zip(self.of.free, at, strict=True)):
            room = min(x - free.lower, free.upper - x)
            step = _SHARE * min(max(room, _LEAST * free.spread), free.spread)
            points[1 + 2 * k, k], points[2 + 2 * k, k] = max(x - step, free.lower), min(x + step, free.upper)
        return points


def _slopes(points: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Derivatives (J, p) from a point and those around it; one-sided where one side failed, zero where both did."""
    slopes = np.zeros((found.shape[1], points.shape[1]))
    for k in range(points.shape[1]):
        sides = [i for i in (1 + 2 * k, 2 + 2 * k) if np.isfinite(found[i]).all()]
        low, high = sides if len(sides) == 2 else (0, sides[0]) if sides else (0, 0)
        if (distance := points[high, k] - points[low, k]) != 0:
            slopes[:, k] = (found[high] - found[low]) / distance
    return slopes


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _called(call: _Call, theta: Any, inputs: Mapping[str, Any]) -> Any:
    shape = jax.ShapeDtypeStruct((call.size(inputs),), float)
    return jax.pure_callback(call.values, shape, theta, inputs, vmap_method="broadcast_all")


@_called.defjvp
def _(call: _Call, primals: Any, tangents: Any) -> Any:
    theta, inputs = primals
    size = call.size(inputs)
    shapes = jax.ShapeDtypeStruct((size,), float), jax.ShapeDtypeStruct((size, theta.size), float)
    values, slopes = jax.pure_callback(call.expansion, shapes, theta, inputs, vmap_method="broadcast_all")
    return values, slopes @ tangents[0]
