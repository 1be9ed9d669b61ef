r"""How much the samples of a correlated residual are worth.

A model that is wrong leaves a residual that is correlated in time.  Counted as independent, a thousand such samples make the
posterior absurdly sure.  The integrated autocorrelation time τ of the residual says that n samples are worth n/τ of them
(Sokal 1997), so each counts with weight 1/τ in the likelihood: a power likelihood, whose maximum stays where it was for one
output, and whose width is right.
"""

import numpy as np

from hsed_jax.inference.likelihood import Data


def autocorrelation_time(residual: np.ndarray) -> float:
    r"""Integrated autocorrelation time of one residual history (m,), in samples; at least 1.

    $\tau = 1 + 2\sum_{k\le K}\rho_k$ with Sokal's window K, the least with $K \ge 5\tau(K)$.  A correlation of neighbours within
    three standard deviations of none counts as none.
    """
    m = residual.size
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if m < 8 or power == 0:
        return 1.0
    size = 2 ** int(np.ceil(np.log2(2 * m)))
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    rho = np.fft.irfft(spectrum, size)[:m] / power
    if abs(rho[1]) < 3 / np.sqrt(m):
        return 1.0
    taus = 1 + 2 * np.cumsum(rho[1:])
    windows = np.arange(1, m)
    enough = np.flatnonzero(windows >= 5 * taus)
    return float(np.clip(taus[enough[0]] if enough.size else m, 1.0, m))


def worths(residual: np.ndarray, weights: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """1/τ per output, (G,): from standardised residuals (n, J), the median τ over the experiments that measured it."""
    found = []
    for group in range(int(groups.max()) + 1):
        columns = groups == group
        taus = [
            autocorrelation_time(r[w > 0])
            for r, w in zip(residual[:, columns], weights[:, columns], strict=True)
            if w.any()
        ]
        found.append(1.0 / float(np.median(taus)) if taus else 1.0)
    return np.asarray(found)


def reweighted(data: Data, worth: np.ndarray, groups: np.ndarray) -> Data:
    """The data with each output's samples counted for what they are worth."""
    return data._replace(weights=(data.weights > 0) * worth[groups][None])
