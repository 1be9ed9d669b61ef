r"""Outputs that need different values of one set of parameters.

Every output alone is fitted from the MAP to second order, with the priors.  F is the Fisher information of an output in the
coordinates u, b the gradient of its negative log likelihood.  The other outputs and the priors determine the parameters with
the precision R and have their optimum at m.  An output g agrees with them if

$$X^2 = d^\top\big(F_g^{-1} + R^{-1}\big)^{-1} d,\qquad d = -F_g^{-1} b_g - m,$$

is a draw of χ² with one degree of freedom for each direction that g determines.  A model that is wrong leaves more than the
noise. F and b of an output are therefore divided by its χ² per datum where that exceeds one, so a general misfit is not a
disagreement.

Source: the test of two estimates for a common value; Cox & Hinkley, Theoretical Statistics (1974), chapter 9.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from hsed_jax.inference.expansion import expand_each
from hsed_jax.inference.likelihood import Data, whitened
from hsed_jax.inference.posterior import Posterior

# Outputs disagree where chance makes so large a difference less often than this, and the misfit falls by this share or more.
_SURE, _MATERIAL = 1e-3, 0.05
# A direction of u with less information than this counts as undetermined: its standard deviation is ten, in coordinates
# of order one.
_TOLD = 1e-2
# Largest change of a parameter, in coordinates of order one: the expansion is not valid beyond it.
_FARTHEST = 3.0
# Parameters that are named in a sentence.
_NAMED = 3


class Estimate(NamedTuple):
    """The estimate of a parameter from some outputs, SI."""

    value: float
    sd: float


@dataclass(frozen=True)
class Disagreement:
    """An output that needs other values of the parameters than the others.

    Attributes:
        output: its name.
        others: names of the other outputs.
        statistic, freedom: χ² of the difference, and its degrees of freedom.
        p_value: probability of so large a difference by chance, for the number of outputs that were tested.
        parameters: by name the estimate of this output alone (`alone`), and of the others (`others`), SI; those that differ most
            first.
        falls: relative reduction of the RMS misfit of the output with its own values.
        units: SI units of the parameters.
    """

    output: str
    others: Sequence[str]
    statistic: float
    freedom: int
    p_value: float
    parameters: Mapping[str, Mapping[str, Estimate]]
    falls: float
    units: Mapping[str, str]

    @property
    def sentence(self) -> str:
        """The values of both, their difference, and possible remedies."""
        others = " and ".join(self.others)
        said = []
        for name, wanted in list(self.parameters.items())[:_NAMED]:
            unit = self.units.get(name, "1")
            alone, rest = (f"{e.value:.4g} ± {e.sd:.2g}" for e in (wanted["alone"], wanted["others"]))
            said.append(f"{name} = {alone} against {rest}{'' if unit == '1' else f' {unit}'}")
        return (
            f"{self.output} demands other parameters than {others} (chi2 {self.statistic:.3g} with {self.freedom} degrees of "
            f"freedom): {', '.join(said)}; with its own values the misfit of {self.output} falls by {100 * self.falls:.0f} %, "
            f"to first order. A physical effect that acts on one of them, or the unit, offset or mass behind one of them, can "
            "join them; a diagnosis looks for the effects"
        )

    def summary(self) -> dict[str, Any]:
        """The key `disagreement` of a calibration in `summary.json`."""
        content = {key: value for key, value in vars(self).items() if key not in ("units", "parameters")}
        parameters = {
            name: {who: estimate._asdict() for who, estimate in wanted.items()}
            for name, wanted in self.parameters.items()
        }
        return content | {"others": list(self.others), "parameters": parameters, "sentence": self.sentence}


class _Told(NamedTuple):
    """The information of an output about the parameters of the model: Fisher information F and the gradient b of its
    negative log likelihood.
    """

    information: Float[np.ndarray, "q q"]
    gradient: Float[np.ndarray, " q"]


def disagreement(
    posterior: Posterior, data: Data, u: Float[np.ndarray, " p"], units: Mapping[str, str]
) -> Disagreement | None:
    """The output that disagrees most with the others; None if all agree, or if there is only one.

    Arguments:
        posterior: of a study without levels.
        data: the fitted data.
        u: the MAP.
        units: SI units of the parameters.
    """
    outputs = [
        g for g in range(len(posterior.outputs)) if np.any(np.asarray(data.weights)[:, posterior.groups == g] > 0)
    ]
    if len(outputs) < 2 or posterior.population.levels or data.decorrelation is not None:
        return None
    size = len(posterior.model_names)
    weights = np.asarray(data.weights)
    # The programs are those of the search for the MAP, so nothing is compiled.
    by_output = {g: weights * (posterior.groups == g) for g in outputs}
    without = np.zeros_like(weights)
    prior, *each = expand_each(posterior, [data._replace(weights=own) for own in (without, *by_output.values())], u)
    precision, pull = np.asarray(prior.hessian)[:size, :size], -np.asarray(prior.slope)[:size]
    told, shrinks = {}, {}
    for (g, own), around in zip(by_output.items(), each, strict=True):
        plain = _Told(np.asarray(around.information)[:size, :size], -np.asarray(around.slope)[:size] - pull)
        left = _chi2(posterior, data, u, np.asarray(around.predicted), np.asarray(around.ok), own)
        step = _optimum([plain], precision, pull)
        gain = -float(2 * plain.gradient @ step + step @ plain.information @ step)
        # The residual of the output with its own values counts as its noise.
        scale = max(1.0, max(left - gain, 0.0) / own.sum())
        told[g] = _Told(plain.information / scale, plain.gradient / scale)
        shrinks[g] = 1 - float(np.sqrt(max(left - gain, 0.0) / left)) if left > 0 else 0.0
    found = {g: _statistic(told[g], [told[h] for h in outputs if h != g], precision, pull) for g in outputs}
    # Two outputs differ from each other by the same amount: one test.
    tests = len(outputs) if len(outputs) > 2 else 1
    values = {g: min(1.0, tests * float(chdtrc(freedom, x))) for g, (x, freedom) in found.items() if freedom}
    sure = [g for g, p in values.items() if p < _SURE and shrinks[g] >= _MATERIAL]
    if not sure:
        return None
    worst = max(sure, key=lambda g: (-values[g], shrinks[g]))
    rest = [told[h] for h in outputs if h != worst]
    return Disagreement(
        posterior.outputs[worst],
        [posterior.outputs[h] for h in outputs if h != worst],
        found[worst][0],
        found[worst][1],
        values[worst],
        _estimates(posterior, u, [told[worst]], rest, precision, pull),
        shrinks[worst],
        units,
    )


def _statistic(
    own: _Told, rest: Sequence[_Told], precision: Float[np.ndarray, "q q"], pull: Float[np.ndarray, " q"]
) -> tuple[float, int]:
    """χ² of the difference between an output and the rest, and its degrees of freedom."""
    values, axes = np.linalg.eigh(own.information)
    kept = values > _TOLD
    if not kept.any():
        return 0.0, 0
    turned = axes[:, kept]
    known = precision + sum(one.information for one in rest)
    known = known + 1e-9 * np.eye(len(known))
    apart = -(turned.T @ own.gradient) / values[kept] - turned.T @ _optimum(rest, precision, pull)
    spread = np.diag(1 / values[kept]) + turned.T @ np.linalg.solve(known, turned)
    return float(apart @ np.linalg.solve(spread, apart)), int(kept.sum())


def _optimum(
    told: Sequence[_Told], precision: Float[np.ndarray, "q q"], pull: Float[np.ndarray, " q"]
) -> Float[np.ndarray, " q"]:
    """The step from the MAP to the optimum of some outputs with the priors."""
    known = precision + sum(one.information for one in told) + 1e-9 * np.eye(len(pull))
    step = -np.linalg.solve(known, pull + sum(one.gradient for one in told))
    return step * min(1.0, _FARTHEST / max(float(np.abs(step).max()), 1e-300))


def _estimates(
    posterior: Posterior,
    u: Float[np.ndarray, " p"],
    own: Sequence[_Told],
    rest: Sequence[_Told],
    precision: Float[np.ndarray, "q q"],
    pull: Float[np.ndarray, " q"],
) -> dict[str, dict[str, Estimate]]:
    """The parameters by an output and by the rest, those that differ most first."""
    import jax
    import jax.numpy as jnp

    found: dict[str, dict[str, Estimate]] = {name: {} for name in posterior.model_names}
    size = len(found)
    for who, told in (("alone", own), ("others", rest)):
        there = np.array(u)
        there[:size] += _optimum(told, precision, pull)
        theta, slope = (
            np.asarray(f(jnp.asarray(there))) for f in (posterior.constrain, jax.jacfwd(posterior.constrain))
        )
        known = precision + sum(one.information for one in told) + 1e-9 * np.eye(size)
        sd = np.abs(np.diag(slope)[:size]) * np.sqrt(np.diag(np.linalg.inv(known)))
        for k, name in enumerate(posterior.model_names):
            found[name][who] = Estimate(float(theta[k]), float(sd[k]))

    def apart(wanted: Mapping[str, Estimate]) -> float:
        one, other = wanted["alone"], wanted["others"]
        return abs(one.value - other.value) / max(float(np.hypot(one.sd, other.sd)), 1e-300)

    return dict(sorted(found.items(), key=lambda item: -apart(item[1])))


def _chi2(
    posterior: Posterior,
    data: Data,
    u: Float[np.ndarray, " p"],
    predicted: Float[np.ndarray, "n J"],
    ok: Float[np.ndarray, " n"],
    weights: Float[np.ndarray, "n J"],
) -> float:
    """Sum of squared residuals of an output, with the weights of the likelihood."""
    import jax.numpy as jnp

    theta = posterior.constrain(jnp.asarray(u))
    z = np.asarray(posterior.standardised(theta, jnp.asarray(predicted), jnp.asarray(ok), data))
    return float(np.sum(weights * whitened(z, np.asarray(data.memory)) ** 2))
