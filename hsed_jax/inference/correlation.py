r"""The effective number of samples of a history, if its noise is autocorrelated or its model is wrong.

Two causes correlate the residual of a history. **Autocorrelated noise** is a property of the sensor, because sensors are
filtered.  The likelihood has it as a first-order autoregression $\rho_k = e^{-\Delta t_k/\ell}$ with a correlation time ℓ per
output.  The change of the residual from sample to sample determines ℓ: $\tfrac12\mathrm E(z_k-z_{k-1})^2 = 1-\rho_k$ with z in
units of the declared noise.  The residual of a wrong model is smooth and adds little to this change.  If no noise is declared,
the two causes cannot be distinguished, and ℓ is inferred only if the study asks for it.

**A wrong model** leaves a residual that is correlated in addition.  If a thousand such samples counted as independent, the
posterior would be far too narrow.  With the integrated autocorrelation time τ of the residual, n samples are equivalent to
n/τ independent ones (Sokal 1997).  Each sample therefore has the weight 1/τ in the likelihood.  This is a power likelihood:
for one output, it keeps the maximum and corrects the width.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc

from hsed_jax.inference.likelihood import whitened

# Below this probability, the noise does not explain the residual.
SIGNIFICANT = 0.01
# Noise counts as autocorrelated if its change from sample to sample is so many standard errors below that of white noise.
_SURE = 3.0
_LEAST_SAMPLES = 30


class Noise(NamedTuple):
    """The noise of one output, estimated from the residual.

    Attributes:
        time: correlation time ℓ [s]; zero for white noise.
        excess: excess kurtosis; zero for a Gaussian.
    """

    time: float
    excess: float


class NoiseEstimate(NamedTuple):
    """The noise of some experiments, and the weights of their samples.

    Attributes:
        memory: ρ of every sample with the one before, (n, J).
        worth: by output, the effective number of each sample, (G,).
        noises: by output.
    """

    memory: np.ndarray
    worth: np.ndarray
    noises: tuple[Noise, ...]


def estimate_noise(
    standardised: np.ndarray,
    gaps: np.ndarray,
    used: np.ndarray,
    groups: np.ndarray,
    declared: np.ndarray,
    correlated: Sequence[bool | None],
) -> NoiseEstimate:
    """Estimate the autocorrelation of the noise, and the remaining correlation of the residual.

    Arguments:
        standardised: residuals in units of the noise, (n, J).
        gaps: time since the previous sample [s], infinite without one, (n, J).
        used: where there is a measurement, (n, J) bool.
        groups: output of each column, (J,).
        declared: by output, whether the size of its noise is declared, (G,).
        correlated: by output, the setting for its noise (`Error.correlated`).
    """
    noises = []
    for output, said in enumerate(correlated):
        own = groups == output
        asked = said if said is not None or declared[output] else False
        noises.append(noise_of(standardised[:, own], gaps[:, own], used[:, own], asked))
    memory = memory_of(gaps, np.asarray([noise.time for noise in noises]), groups)
    worth = worths(whitened(standardised, memory), used, groups)
    return NoiseEstimate(memory, np.where([said is False for said in correlated], 1.0, worth), tuple(noises))


def correlation_notes(outputs: Sequence[str], groups: np.ndarray, weights: np.ndarray, memory: np.ndarray) -> list[str]:
    """Sentences on outputs whose noise is autocorrelated, or whose residual is correlated in addition.

    Arguments:
        outputs: their names.
        groups: the output that each column of the data belongs to, (J,).
        weights: effective number of each sample, zero for unused samples, (n, J).
        memory: correlation of its noise with that of the previous sample, (n, J).
    """
    notes = []
    for output, name in enumerate(outputs):
        own = (weights > 0) & (groups == output)
        if not own.any():
            continue
        if (rho := float(np.median(memory[own]))) > 0:
            notes.append(f"the noise of {name} is autocorrelated: the correlation of neighbouring samples is {rho:.2g}")
        if (worth := float(weights[own].min())) < 1:
            samples = int(own.sum())
            notes.append(
                f"the residual of {name} is correlated over {1 / worth:.2g} samples{' beyond that' if rho > 0 else ''}: "
                f"its {samples} samples count as {max(1, round(samples * worth))}"
            )
    return notes


def noise_of(standardised: np.ndarray, gaps: np.ndarray, used: np.ndarray, correlated: bool | None) -> Noise:
    """Correlation time and kurtosis of the noise of one output.

    Arguments:
        standardised: residuals of the output in units of its noise, (n, m).
        gaps: time since the previous sample [s], infinite without one, (n, m).
        used: where there is a measurement, (n, m) bool.
        correlated: whether the noise is autocorrelated; None: if the residual shows it.
    """
    pairs = np.isfinite(gaps) & used
    if pairs.sum() < _LEAST_SAMPLES or not standardised[used].any():
        return Noise(0.0, 0.0)
    before = np.roll(standardised, 1, axis=1)
    changes, gap = 0.5 * (standardised - before)[pairs] ** 2, gaps[pairs]
    excess = _excess(standardised, pairs)
    if correlated is False:
        return Noise(0.0, excess)
    change = float(changes.mean())
    # Neighbouring changes share a sample: for white noise their squares have a correlation of a quarter.
    uncertain = float(np.sqrt(1.5 * changes.var() / changes.size))
    lag_one = float((standardised * before)[pairs].mean() / (standardised[used] ** 2).mean())
    if lag_one + _SURE * np.sqrt(max(1 - lag_one**2, 0.0) / changes.size) < 1 - change:
        # The noise is smaller than declared, so it is less correlated than its size alone suggests.
        change = 1 - lag_one
    if change >= 1 - _SURE * uncertain or lag_one < _SURE / np.sqrt(changes.size):
        return Noise(0.0, excess)
    typical = float(np.median(gap))

    def beyond(log_time: float) -> float:
        return float(np.mean(-np.expm1(-gap / np.exp(log_time)))) - change

    low, high = np.log(1e-3 * typical), np.log(1e9 * typical)
    root: Any = brentq(beyond, low, high) if beyond(high) < 0 else high
    return Noise(float(np.exp(root)), excess)


def _excess(standardised: np.ndarray, pairs: np.ndarray) -> float:
    """Excess kurtosis of the noise, from second differences, in which a smooth error of the model cancels.

    For independent noise, second differences have half of its excess: Σc⁴/(Σc²)² = 18/36 for the coefficients 1, −2, 1.
    """
    triples = pairs & np.roll(pairs, 1, axis=1)
    triples[:, :2] = False
    second = (standardised - 2 * np.roll(standardised, 1, axis=1) + np.roll(standardised, 2, axis=1))[triples]
    power = float(np.mean(second**2)) if second.size else 0.0
    return 2 * max(float(np.mean(second**4)) / power**2 - 3, 0.0) if power > 0 else 0.0


def memory_of(gaps: np.ndarray, times: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """ρ of every sample with the one before, (n, J), from the gaps [s] and the correlation times of the outputs, (G,)."""
    time = times[groups]
    return np.where(time > 0, np.exp(-gaps / np.where(time > 0, time, 1.0)), 0.0)


def size_p_value(standardised: np.ndarray, used: np.ndarray, memory: np.ndarray, noises: dict[int, Noise], groups: np.ndarray,
                 parameters: int) -> float | None:  # fmt: skip
    r"""Probability that noise of the declared size causes a residual this large; None with no more measurements than
    parameters.

    $\sum z^2$ has the mean N − p.  Its variance is 2N for independent Gaussian noise; kurtosis and autocorrelation make it
    $2N\,(1+\kappa/2)\,\overline{(1+\rho^2)/(1-\rho^2)}$.  A scaled χ² with these moments (Satterthwaite 1946) is exact for
    white Gaussian noise.

    Arguments:
        standardised: residuals in units of the declared noise, (n, J).
        used: where there is a measurement to judge, (n, J) bool.
        memory: ρ, (n, J).
        noises: by output.
        groups: output of each column, (J,).
        parameters: how many were fitted.
    """
    used = used & np.isin(groups, list(noises))
    total = int(used.sum())
    if total <= parameters:
        return None
    worse = sum(
        float(((1 + memory**2) / (1 - memory**2))[used & (groups == output)].sum()) * (1 + noise.excess / 2)
        for output, noise in noises.items()
    ) / total  # fmt: skip
    return float(chdtrc((total - parameters) / worse, float((standardised[used] ** 2).sum()) / worse))


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


def worths(residual: np.ndarray, used: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """1/τ per output, (G,): from whitened residuals (n, J), the median τ over the experiments that measured it."""
    found = []
    for group in range(int(groups.max()) + 1):
        columns = groups == group
        taus = [
            autocorrelation_time(r[u > 0])
            for r, u in zip(residual[:, columns], used[:, columns], strict=True)
            if u.any()
        ]
        found.append(1.0 / float(np.median(taus)) if taus else 1.0)
    return np.asarray(found)
