"""What generic tools make of an imposed elongation and a measured force: least squares for the law, and two black boxes.

The law is the one that `hsed init` starts from, Bouc–Wen, here with all four of its parameters free; it shares no code with the
package.  The black boxes know the elongation and what a hysteretic force is known to depend on: where the motion last turned,
how far it ever went, how long its path is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

_STARTS, _SUBSTEPS = 8, 4
# A Gaussian process of more samples takes minutes.
_MOST_SAMPLES = 1200


@dataclass(frozen=True)
class Cyclic:
    """A test: elongation and force over the samples, (n,), and which of them count."""

    elongation: np.ndarray
    force: np.ndarray
    counts: np.ndarray


def least_squares_error(train: Sequence[Cyclic], test: Sequence[Cyclic]) -> float:
    """Error on tests of the law fitted to others by SciPy's least squares from several starts."""
    from scipy.optimize import least_squares

    elongation = max(np.abs(one.elongation[one.counts]).max() for one in train)
    strength = max(np.abs(one.force[one.counts]).max() for one in train)
    stiffness = 4.0 * strength / elongation

    def forces(p: np.ndarray, tests: Sequence[Cyclic]) -> list[np.ndarray]:
        A, beta = stiffness * np.exp(p[0]), np.exp(p[1])
        return [_bouc_wen(one.elongation, A, strength, beta, beta * np.tanh(p[2]), np.exp(p[3])) for one in tests]

    def residual(p: np.ndarray) -> np.ndarray:
        parts = zip(forces(p, train), train, strict=True)
        return np.nan_to_num(np.concatenate([(f - one.force)[one.counts] for f, one in parts]) / strength, posinf=1e6)

    random = np.random.default_rng(0)
    starts = random.uniform([-1.5, -1.0, -1.0, -0.3], [1.5, 1.0, 1.0, 1.2], (_STARTS, 4))
    fits = [least_squares(residual, start, x_scale="jac", max_nfev=60) for start in starts]
    return _error(forces(min(fits, key=lambda fit: fit.cost).x, test), test)


def _bouc_wen(u: np.ndarray, A: float, scale: float, beta: float, gamma: float, n: float) -> np.ndarray:
    """The force r = sζ of dζ/du = (A/s) (1 − |ζ|ⁿ (β sign(ζ du) + γ)), by Heun's rule in parts of a sample."""
    zeta, found = 0.0, np.empty(len(u))
    for k, step in enumerate(np.diff(u, prepend=u[0]) / _SUBSTEPS):
        way = beta if step >= 0 else -beta
        for _ in range(_SUBSTEPS):
            one = 1 - abs(zeta) ** n * ((way if zeta >= 0 else -way) + gamma)
            ahead = min(max(zeta + step * A / scale * one, -9.0), 9.0)
            two = 1 - abs(ahead) ** n * ((way if ahead >= 0 else -way) + gamma)
            zeta = min(max(zeta + step * A / scale * 0.5 * (one + two), -9.0), 9.0)
        found[k] = zeta
    return scale * found


def black_box_errors(train: Sequence[Cyclic], test: Sequence[Cyclic]) -> dict[str, float]:
    """Errors on tests of a Gaussian process and of a neural network trained on others; none without scikit-learn."""
    if find_spec("sklearn") is None:
        return {}
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    known = np.concatenate([_features(one.elongation)[one.counts] for one in train])
    target = np.concatenate([one.force[one.counts] for one in train])
    scale = np.std(target)
    kernel = ConstantKernel(1.0) * RBF(np.ones(known.shape[1]), (1e-2, 1e3)) + WhiteKernel(1e-2)
    every = -(-len(known) // _MOST_SAMPLES)
    boxes = {
        "Gaussian process": (GaussianProcessRegressor(kernel, random_state=0), every),
        "neural network": (
            MLPRegressor(hidden_layer_sizes=(64, 64), max_iter=2000, early_stopping=True, random_state=0),
            1,
        ),
    }
    errors = {}
    for name, (box, each) in boxes.items():
        model = make_pipeline(StandardScaler(), box).fit(known[::each], target[::each] / scale)
        errors[name] = _error([scale * model.predict(_features(one.elongation)) for one in test], test)
    return errors


def _features(u: np.ndarray) -> np.ndarray:
    """Elongation, way, last two turning points, largest and smallest so far, path so far: (n, 7)."""
    moves = np.sign(np.diff(u, prepend=u[0]))
    turned, before, way = np.zeros(len(u)), np.zeros(len(u)), np.zeros(len(u))
    last, earlier, now = u[0], u[0], 0.0
    for k, move in enumerate(moves):
        if move and move != now:
            last, earlier, now = (u[k - 1] if k else u[0]), last, move
        turned[k], before[k], way[k] = last, earlier, now
    path = np.cumsum(np.abs(np.diff(u, prepend=u[0])))
    return np.column_stack([u, way, turned, before, np.maximum.accumulate(u), np.minimum.accumulate(u), path])


def _error(forces: Sequence[np.ndarray], tests: Sequence[Cyclic]) -> float:
    """Root mean square of what is predicted less what was measured, in units of the measurement's own about its mean."""
    predicted = np.concatenate([force[one.counts] for force, one in zip(forces, tests, strict=True)])
    measured = np.concatenate([one.force[one.counts] for one in tests])
    return float(np.sqrt(np.mean((predicted - measured) ** 2)) / np.std(measured))
