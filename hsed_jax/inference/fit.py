"""A calibrated model: MAP, posterior draws and whether to believe them, as one object that shows itself."""

from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.correlation import reweighted, worths
from hsed_jax.inference.likelihood import Data, standardised_residual
from hsed_jax.inference.maximum import Maximum, maximise
from hsed_jax.inference.nuts import Chains, Convergence, Settings, convergence
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.sampling import draw
from hsed_jax.inference.watch import Watch, arrays_of, fingerprint, tree_like
from hsed_jax.tables import Table, Tabular, cell


@dataclass(frozen=True, repr=False)
class Fit(Tabular):
    """Result of a calibration.

    Attributes:
        posterior: what was calibrated.
        data: on what.
        maximum: the MAP (Eq. 6) with its Gauss–Newton covariance and the Laplace evidence.
        chains: draws of the posterior.
        convergence: R-hat, bulk ESS, divergences.
        units: SI unit of each parameter, by name.
    """

    posterior: Posterior
    data: Data
    maximum: Maximum
    chains: Chains
    convergence: Convergence
    units: dict[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, inferred errors last."""
        return self.posterior.names

    @cached_property
    def map(self) -> dict[str, float]:
        """θ_MAP by name, SI."""
        return dict(zip(self.names, np.asarray(self.maximum.theta).tolist(), strict=True))

    @property
    def warning(self) -> str | None:
        """What is wrong with the draws, in one sentence, or None."""
        faults = (self.chains.cut_short, self.convergence.warning(self.names))
        return "; ".join(fault for fault in faults if fault) or None

    def summary(self) -> dict[str, dict[str, float]]:
        """Mean, sd, 5 % and 95 % quantile, bulk ESS and R-hat of each parameter, SI."""
        return summarise(self.names, self.chains, self.convergence)

    def _table(self) -> Table:
        rows = [
            (
                f"{name} [{self.units.get(name, '1')}]",
                *(cell(v, ".4g") for v in (self.map[name], s["mean"], s["sd"], s["q05"], s["q95"])),
                cell(s["ess_bulk"], ".0f"),
                cell(s["rhat"]),
            )
            for name, s in self.summary().items()
        ]
        found = {
            "nuts": "converged, no divergences",
            "importance": "draws by importance sampling",
            "laplace": "draws of the Gaussian around the MAP, not of the posterior",
        }[self.chains.sampler]
        state = f"warning: {self.warning}" if self.warning else found
        heads = ("parameter", "MAP", "mean", "sd", "5 %", "95 %", "ESS", "R-hat")
        return Table(f"calibrated on {int(self.data.count)} experiments; {state}", heads, rows)


def fit(
    posterior: Posterior,
    data: Data,
    *,
    starts: int,
    settings: Settings,
    key: PRNGKeyArray,
    units: dict[str, str],
    correlated: bool = False,
    start: Array | None = None,
    watch: Watch | None = None,
    seconds: float | None = None,
) -> Fit:
    """Calibrate: MAP from several starts, then draws of the posterior around it.

    Arguments:
        posterior: prior and likelihood of the study.
        data: measured outputs.
        starts: number of starts of the MAP.
        settings: sizes of the sample, and by which sampler.
        key: of the random numbers.
        units: SI units of the parameters, for reports.
        correlated: let the samples of an output whose residual at the MAP is correlated count for what they are worth
            (`hsed_jax.inference.correlation`), and fit again.
        start: parameters of the model (SI, without inferred errors) to start one of the searches from.
        watch: follows the calibration.
        seconds: budget of NUTS.
    """
    watch = watch or Watch()
    points = posterior.starts(starts)
    if start is not None:
        middle = posterior.constrain(points[0])
        points = points.at[0].set(posterior.unconstrain(middle.at[: start.size].set(start)))
    name = f"maximum-{fingerprint(posterior.names, eqx.filter(posterior, eqx.is_array), data, points, correlated)}"
    if (kept := watch.recall(name)) is not None:
        split = len(kept) - len(Maximum._fields)
        data, maximum = tree_like(data, kept[:split]), Maximum(*map(jnp.asarray, kept[split:]))
    else:
        watch.report("the most probable parameters")
        data, maximum = _most_probable(posterior, data, points, correlated)
        watch.keep(name, arrays_of((data, maximum)))
    chains = draw(posterior, data, maximum, jnp.asarray(0.8), key, settings, watch, seconds)
    return Fit(posterior, data, maximum, chains, convergence(chains), units)


def _most_probable(
    posterior: Posterior, data: Data, points: Float[Array, "s p"], correlated: bool
) -> tuple[Data, Maximum]:
    """The MAP, and the data with the weights it was found with."""
    maximum = maximise(posterior, data, points)
    if correlated:
        predicted, ok = posterior.predict(posterior.of_model(maximum.theta), data.conditions, data.count)
        residual = standardised_residual(predicted, ok, posterior.errors(maximum.theta), data)
        worth = worths(np.asarray(residual), np.asarray(data.weights), posterior.groups)
        if np.any(worth < 1):
            data = reweighted(data, worth, posterior.groups)
            maximum = maximise(posterior, data, points.at[0].set(maximum.u))
    return data, maximum


def summarise(names: tuple[str, ...], chains: Chains, judged: Convergence) -> dict[str, dict[str, float]]:
    """Mean, sd, quantiles and diagnostics of each parameter's draws."""
    draws = np.asarray(chains.theta).reshape(-1, len(names))
    q05, q95 = np.quantile(draws, [0.05, 0.95], axis=0)
    return {
        name: {
            "mean": float(draws[:, i].mean()),
            "sd": float(draws[:, i].std(ddof=1)),
            "q05": float(q05[i]),
            "q95": float(q95[i]),
            "ess_bulk": float(judged.ess_bulk[i]),
            "rhat": float(judged.rhat[i]),
        }
        for i, name in enumerate(names)
    }
