"""The scikit-learn peer of the surrogate: Kriging by maximum likelihood, and the expected improvement over its mean."""

import warnings
from importlib.util import find_spec

import numpy as np
from scipy.stats import norm

NOTE = "scikit-learn is not installed, so it was not measured"
STARTS = 10
LENGTHS, NUGGETS = (0.02, 20.0), (1e-10, 1.0)


def is_there() -> bool:
    """Whether scikit-learn is installed."""
    return find_spec("sklearn") is not None


def fitted(x: np.ndarray, y: np.ndarray):
    """A Gaussian process with a Matérn 5/2 kernel and a nugget, the best of ten starts."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    matern = ConstantKernel(1.0, (1e-3, 1e4)) * Matern([0.5] * x.shape[1], LENGTHS, nu=2.5)
    kernel = matern + WhiteKernel(1e-2, NUGGETS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of optima on a bound
        return GaussianProcessRegressor(kernel, n_restarts_optimizer=STARTS - 1, normalize_y=True, random_state=0).fit(
            x, y
        )


def hyperparameters(model) -> tuple[float, np.ndarray, float]:
    """Process variance, lengths and nugget variance, of the normalised responses."""
    smooth, white = model.kernel_.k1, model.kernel_.k2
    return smooth.k1.constant_value, smooth.k2.length_scale, white.noise_level


def improvement(model, points: np.ndarray) -> np.ndarray:
    """Expected improvement over the largest mean at the tested points, without the nugget's scatter."""
    mean, deviation = model.predict(points, return_std=True)
    noise = hyperparameters(model)[2] * model._y_train_std**2
    deviation = np.sqrt(np.maximum(deviation**2 - noise, 1e-30))
    best = model.predict(model.X_train_).max()
    z = (mean - best) / deviation
    return (mean - best) * norm.cdf(z) + deviation * norm.pdf(z)
