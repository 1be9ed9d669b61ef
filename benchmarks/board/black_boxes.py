"""Two black boxes: a Gaussian process of the path features, and a recurrent network.

Both know the elongation of all rows and the force of the fitted rows, like every method of the board, and simulate: no measured
force is an input. All inputs and the force are divided by scales of the fitted rows.

* Gaussian process: zero mean, Matern 5/2 kernel with a length for each of seven features (elongation, direction, last two turning
  points, largest and smallest elongation so far, path so far) and noise. At most 400 fitted rows condition it, equally spaced.
  The hyperparameters maximise the marginal likelihood (L-BFGS, the better of two starts).
* Network: gated recurrent units (Cho et al. 2014) of one layer; inputs elongation, its step, largest and smallest elongation and
  path so far; a linear output beside a linear path from the inputs. It is trained by Adam on windows of the fitted rows. The last
  fifth of the fitted rows stops the training early and chooses among three settings. The chosen setting is then trained on all
  fitted rows for as many updates as were best.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from board.records import Test, scales_of
from scipy.optimize import minimize
from tinygp import GaussianProcess, kernels, transforms
from tinygp.kernels.distance import L2Distance

_CONDITIONED = 400
_SETTINGS = ((12, 1e-2), (24, 1e-2), (24, 3e-3))
"""Units and learning rate."""
_VALIDATION, _UPDATES, _EVERY, _PATIENCE = 0.2, 600, 25, 6
_WINDOW, _WARM_UP = 96, 32


def gaussian_process(tests: Sequence[Test]) -> list[np.ndarray]:
    """Force of every test, (n,) [N], predicted by a Gaussian process of the path features."""
    _, strength = scales_of(tests)
    rows = np.concatenate([test.fitted for test in tests])
    features = np.concatenate([_features(test) for test in tests])
    features = (features - features[rows].mean(axis=0)) / np.maximum(features[rows].std(axis=0), 1e-9)
    force = np.concatenate([test.force for test in tests])[rows] / strength
    chosen = np.unique(np.linspace(0, rows.sum() - 1, min(_CONDITIONED, rows.sum())).astype(int))
    x, y = jnp.asarray(features[rows][chosen]), jnp.asarray(force[chosen])

    def process(p: jax.Array, x: jax.Array) -> GaussianProcess:
        kernel = jnp.exp(2 * p[0]) * transforms.Linear(jnp.exp(-p[2:]), kernels.Matern52(distance=L2Distance()))
        return GaussianProcess(kernel, x, diag=jnp.exp(2 * p[1]) + 1e-8)

    loss = jax.jit(jax.value_and_grad(lambda p: -process(p, x).log_probability(y)))
    low, high = np.log([1e-2, 1e-3, *[0.1] * x.shape[1]]), np.log([10.0, 1.0, *[100.0] * x.shape[1]])
    starts = [np.log([1.0, 0.05, *[length] * x.shape[1]]) for length in (1.0, 5.0)]
    fits = [
        minimize(
            loss, start, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)), options={"maxiter": 50}
        )
        for start in starts
    ]
    best = jnp.asarray(min(fits, key=lambda fit: fit.fun).x)
    predict = jax.jit(lambda new: process(best, x).predict(y, new))
    return [strength * np.asarray(part) for part in np.split(predict(jnp.asarray(features)), _ends(tests))]


def network(tests: Sequence[Test]) -> list[np.ndarray]:
    """Force of every test, (n,) [N], predicted by a recurrent network."""
    rows = [np.flatnonzero(test.fitted) for test in tests]
    behind = np.cumsum([len(r) for r in rows])
    # The rows of several tests are one sequence here: the last of them are the validation.
    first = round((1 - _VALIDATION) * behind[-1])
    early, late = [], []
    for test, own, end in zip(tests, rows, behind, strict=True):
        keep = max(0, min(len(own), first - (int(end) - len(own))))
        masks = np.zeros((2, len(test.force)))
        masks[0, own[:keep]], masks[1, own[keep:]] = 1.0, 1.0
        early.append(masks[0])
        late.append(masks[1])
    inputs, force = _inputs(tests)
    runs = [_trained(inputs, force, early, late, *setting) for setting in _SETTINGS]
    best = min(runs, key=lambda run: run.loss)
    everything = [a + b for a, b in zip(early, late, strict=True)]
    final = _trained(inputs, force, everything, None, *best.setting, updates=best.updates)
    strength = scales_of(tests)[1]
    return [
        strength * np.asarray(_simulated(final.weights, x))[: len(t.force)] for x, t in zip(inputs, tests, strict=True)
    ]


class _Run(NamedTuple):
    weights: dict[str, jax.Array]
    loss: float
    updates: int
    setting: tuple[int, float]


def _trained(inputs, force, counts, validation, units: int, rate: float, updates: int = _UPDATES) -> _Run:
    """Train on windows of rows; where there is a validation, keep the weights that are best on it."""
    windows = [np.concatenate(parts) for parts in zip(*map(_windows, inputs, force, counts), strict=True)]
    x, y, weight = (jnp.asarray(part, jnp.float32) for part in windows)
    weights = _initial(x.shape[2], units)
    moments = jax.tree.map(jnp.zeros_like, (weights, weights))
    best, waited = _Run(weights, np.inf, updates, (units, rate)), 0
    for update in range(1, updates + 1):
        # The rate falls to a tenth over the training.
        weights, moments = _update(weights, moments, x, y, weight, update, rate * 0.1 ** (update / _UPDATES))
        if validation is None or update % _EVERY:
            continue
        loss = sum(
            float(_loss_of(weights, *part)) for part in zip(inputs, force, validation, strict=True) if part[2].any()
        )
        best, waited = (_Run(weights, loss, update, (units, rate)), 0) if loss < best.loss else (best, waited + 1)
        if waited == _PATIENCE:
            break
    return _Run(weights, 0.0, updates, (units, rate)) if validation is None else best


def _initial(inputs: int, units: int) -> dict[str, jax.Array]:
    random = np.random.default_rng(0)
    shapes = {"in": (inputs, 3 * units), "state": (units, 3 * units), "out": (units, 1), "direct": (inputs, 1)}
    weights = {name: jnp.asarray(random.normal(size=s) / np.sqrt(s[0]), jnp.float32) for name, s in shapes.items()}
    return weights | {"bias": jnp.zeros(3 * units, jnp.float32), "offset": jnp.zeros(1, jnp.float32)}


def _simulate(weights, x):
    """Output of a sequence (n, ..., inputs) from a state of zero, (n, ...)."""
    units = weights["state"].shape[0]
    before = x @ weights["in"] + weights["bias"]

    def body(state, now):
        from_state = state @ weights["state"]
        update, reset = jnp.split(jax.nn.sigmoid(now[..., : 2 * units] + from_state[..., : 2 * units]), 2, axis=-1)
        proposed = jnp.tanh(now[..., 2 * units :] + reset * from_state[..., 2 * units :])
        state = (1 - update) * state + update * proposed
        return state, state

    states = jax.lax.scan(body, jnp.zeros((*x.shape[1:-1], units), jnp.float32), before)[1]
    return (states @ weights["out"] + x @ weights["direct"] + weights["offset"])[..., 0]


_simulated = jax.jit(_simulate)


@jax.jit
def _loss_of(weights, x, y, weight):
    return jnp.sum(weight * (_simulate(weights, x) - y) ** 2)


@jax.jit
def _update(weights, moments, x, y, weight, count, rate):
    """Adam, with a gradient of norm 1 at most."""

    def loss(weights):
        return jnp.sum(weight * (_simulate(weights, x.swapaxes(0, 1)).T - y) ** 2) / jnp.sum(weight)

    gradient = jax.grad(loss)(weights)
    norm = jnp.sqrt(sum(jnp.sum(g**2) for g in jax.tree.leaves(gradient)))
    gradient = jax.tree.map(lambda g: g / jnp.maximum(norm, 1.0), gradient)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, moments[0], gradient)
    second = jax.tree.map(lambda m, g: 0.999 * m + 0.001 * g**2, moments[1], gradient)

    def moved(w, m, v):
        return w - (rate * (m / (1 - 0.9**count)) / (jnp.sqrt(v / (1 - 0.999**count)) + 1e-8)).astype(w.dtype)

    return jax.tree.map(moved, weights, first, second), (first, second)


def _windows(x, y, weight):
    """Windows of a sequence that begin with rows whose error does not count: (w, rows, inputs), (w, rows), (w, rows)."""
    starts = np.arange(0, len(y), _WINDOW)
    parts: list[list[np.ndarray]] = [[], [], []]
    for start in starts:
        rows = np.arange(start - _WARM_UP, start + _WINDOW)
        inside = np.clip(rows, 0, len(y) - 1)
        counts = weight[inside] * (rows >= start) * (rows < len(y))
        if counts.any():
            for part, values in zip(parts, (x[inside], y[inside], counts), strict=True):
                part.append(values)
    shapes = ((0, _WARM_UP + _WINDOW, x.shape[1]), (0, _WARM_UP + _WINDOW), (0, _WARM_UP + _WINDOW))
    return [np.stack(part) if part else np.empty(shape) for part, shape in zip(parts, shapes, strict=True)]


def _inputs(tests: Sequence[Test]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Inputs (n, 5) and force (n,) of each test, scaled, padded to one of few lengths."""
    scale, strength = scales_of(tests)
    inputs, forces = [], []
    for test in tests:
        u = test.elongation / scale
        step = np.diff(u, prepend=0.0)
        path = np.cumsum(np.abs(step))
        columns = [u, step, np.maximum.accumulate(u), np.minimum.accumulate(u), path]
        inputs.append(np.column_stack(columns))
        forces.append(test.force / strength)
    rows = np.concatenate([test.fitted for test in tests])
    spread = np.maximum(np.concatenate(inputs)[rows].std(axis=0), 1e-9)
    return [(x / spread).astype(np.float32) for x in inputs], [f.astype(np.float32) for f in forces]


def _features(test: Test) -> np.ndarray:
    """Elongation, direction, last two turning points, largest and smallest so far, path so far: (n, 7)."""
    u = test.elongation
    moves = np.sign(np.diff(u, prepend=0.0))
    points, last, earlier, way = np.zeros((len(u), 3)), 0.0, 0.0, 0.0
    for k, move in enumerate(moves):
        if move and move != way:
            last, earlier, way = (float(u[k - 1]) if k else 0.0), last, move
        points[k] = way, last, earlier
    path = np.cumsum(np.abs(np.diff(u, prepend=0.0)))
    return np.column_stack([u, points, np.maximum.accumulate(u), np.minimum.accumulate(u), path])


def _ends(tests: Sequence[Test]) -> np.ndarray:
    return np.cumsum([len(test.force) for test in tests])[:-1]
