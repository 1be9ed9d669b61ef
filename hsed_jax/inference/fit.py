"""A calibrated model as one object that displays itself: MAP, draws of the posterior, and whether they are reliable."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.correlation import SIGNIFICANT, correlation_notes
from hsed_jax.inference.disagreement import Disagreement, disagreement
from hsed_jax.inference.expansion import expand
from hsed_jax.inference.leaning import Leaning, Range, caution, leaning
from hsed_jax.inference.likelihood import Data, Error
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.most_probable import (
    against_declared,
    known_start,
    left_unexplained,
    most_probable,
    noise_left,
    read_back,
)
from hsed_jax.inference.nuts import Chains, Convergence, Settings, convergence, statistics_of, summarise
from hsed_jax.inference.population import Varying
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.samplers import SAMPLERS
from hsed_jax.inference.sampling import draw
from hsed_jax.inference.watch import Watch, arrays_of, fingerprint
from hsed_jax.programs import program
from hsed_jax.tables import Table, Tabular, cell

if TYPE_CHECKING:
    # A calibration without a discrepancy loads no Gaussian process.
    from hsed_jax.inference.discrepancy.base import AbstractDiscrepancy
    from hsed_jax.inference.discrepancy.inputs import Support


@dataclass(frozen=True, repr=False)
class Fit(Tabular):
    """Result of a calibration.

    Attributes:
        posterior: the calibrated one.
        data: the fitted data.
        maximum: the MAP (Eq. 6) with its Gauss–Newton covariance and the Laplace evidence.
        chains: draws of the posterior.
        convergence: R-hat, bulk ESS, divergences.
        units: SI unit of each parameter, by name.
        chi2_per_datum: mean square of the residual in units of the declared noise; None without a declared noise.
        p_value: probability that the declared noise alone causes so large a residual.
        is_inflated: whether the residual beyond the declared noise counts as error.
        inflation: factor by which this increases the declared error of each output, (G,); None: no increase.
        discrepancy: of the model, if it is learned with the parameters.
        support: the variables of the discrepancy.
        possible: physically possible range of each parameter of the model, SI, by name (`hsed_jax.inference.leaning`).
    """

    posterior: Posterior
    data: Data
    maximum: Maximum
    chains: Chains
    convergence: Convergence
    units: dict[str, str]
    chi2_per_datum: float | None = None
    p_value: float | None = None
    is_inflated: bool = False
    inflation: np.ndarray | None = None
    discrepancy: "AbstractDiscrepancy | None" = None
    support: "Support | None" = None
    possible: Mapping[str, Range] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters: of the model, inferred errors, spreads of a population."""
        return self.posterior.reported

    @cached_property
    def map(self) -> dict[str, float]:
        """θ_MAP by name, SI."""
        return dict(zip(self.names, np.asarray(self.maximum.theta).tolist(), strict=False))

    @property
    def warning(self) -> str | None:
        """Faults of the draws, or that the posterior has several modes, in one sentence; else None."""
        found = (
            self.chains.doubt,
            self.maximum.warning(self.posterior.names),
            self.convergence.warning(self.posterior.names),
        )
        return "; ".join(filter(None, found)) or None

    @cached_property
    def leaning(self) -> tuple[Leaning, ...]:
        """The estimates on a bound of their prior that is not a physical limit."""
        return leaning(self.posterior.priors, self.possible, self.map, self.summary())

    @cached_property
    def caution(self) -> str | None:
        """The warnings before any use of an estimate (`hsed_jax.inference.leaning.caution`), or None."""
        own = {name: self.map[name] for name in self.posterior.model_names}
        return caution(self.leaning, self.posterior.priors, own, self.summary(), self.units)

    @cached_property
    def disagreement(self) -> Disagreement | None:
        """An output that demands other values of the parameters than the others; None where they agree."""
        return disagreement(self.posterior, self.data, np.asarray(self.maximum.u), self.units)

    @property
    def doubt(self) -> str | None:
        """The meaning of the intervals if the model does not explain the data, in one sentence; else None."""
        if (
            self.chi2_per_datum is None
            or self.p_value is None
            or self.p_value >= SIGNIFICANT
            or self.chi2_per_datum < 1
        ):
            return None
        if self.discrepancy is not None:
            worth = "the model discrepancy covers the rest, and the intervals are those of the best parameters of this model"
        elif self.is_inflated:
            worth = "the intervals count the rest as error, and are those of the best parameters of this model"
        else:
            worth = (
                "the intervals assume that the model is right, and are too narrow (error: {inflate: true} widens them by the "
                "rest; error: {discrepancy: true} learns the rest)"
            )
        left = f"(chi2 per datum {self.chi2_per_datum:.3g}, which should be about 1)"
        return f"the model does not explain the data {left}: {worth}"

    def discrepancy_summary(self) -> dict[str, dict[str, float]]:
        """The discrepancy in numbers (`hsed_jax.inference.discrepancy.kinds.summary`)."""
        from hsed_jax.inference.discrepancy.kinds import summary

        assert self.discrepancy is not None
        return summary(self.discrepancy, self.posterior, self.support)

    def correlation_notes(self) -> list[str]:
        """Sentences on outputs whose noise is autocorrelated, or whose residual is correlated beyond it."""
        weights, memory = np.asarray(self.data.weights), np.asarray(self.data.memory)
        return correlation_notes(self.posterior.outputs, self.posterior.groups, weights, memory)

    def summary(self) -> dict[str, dict[str, float]]:
        """Mean, sd, 5 % and 95 % quantile, bulk ESS and R-hat of each parameter, SI."""
        return summarise(self.names, self.chains, self.convergence)

    @cached_property
    def of_members(self) -> tuple[Float[np.ndarray, "chains draws M q"], ...]:
        """Draws of the model's parameters of each member, SI, an array a level."""
        if not self.posterior.population.levels:
            return ()
        members = np.asarray(self.data.members)[: int(self.data.count)]
        found = _of_members(self.posterior, self.chains.theta, tuple(map(tuple, members.tolist())))
        return tuple(np.asarray(one) for one in found)

    def levels(self) -> dict[str, dict[str, dict[str, Any]]]:
        """The varying parameters: by level and parameter the `mean` (the centre of the population) and `spread` (for a
        positive parameter that of its logarithm), its value `of` each member, and that of an `untested` one; as `summary` has
        them, SI."""
        known, found = self.summary(), {}
        levels = self.posterior.population.levels
        for number, (level, draws) in enumerate(zip(levels, self.of_members, strict=True)):
            found[level.name] = {}
            for varying in level.varying:
                own = [statistics_of(draws[..., m, varying.column].ravel()) for m in range(len(level.members))]
                found[level.name][varying.name] = {
                    "mean": known[varying.name],
                    "spread": known[f"{level.name}.{varying.name}.spread"],
                    "of": dict(zip(level.members, own, strict=True)),
                    "untested": statistics_of(self._untested(varying, number)),
                }
        return found

    def _untested(self, varying: Varying, level: int) -> Float[np.ndarray, " S"]:
        """Draws of a parameter of a specimen that is a new member of a level and of those around it, SI."""
        posterior, population = self.posterior, self.posterior.population
        draws = self.chains.theta.reshape(-1, self.chains.theta.shape[-1])
        members = jnp.asarray([[len(level.members) for level in population.levels]])
        offsets = population.strangers(members, len(draws))
        # The levels within it have no member here, so their offset is zero.
        offsets = tuple(o if k <= level else jnp.zeros_like(o) for k, o in enumerate(offsets))

        def one(theta, offsets):
            return population.own(theta, posterior.of_model(theta), members, offsets)[0, varying.column]

        return np.asarray(jax.vmap(one)(draws, offsets))

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
        found = SAMPLERS[self.chains.sampler].state
        state = f"warning: {self.warning}" if self.warning else found
        for level, parameters in self.levels().items():
            for name, about in parameters.items():
                for member, v in about["of"].items():
                    numbers = (cell(v[key], ".4g") for key in ("mean", "sd", "q05", "q95"))
                    rows.append((f"{name} of {level} {member}", "", *numbers, "", ""))
        notes = [] if self.doubt is None else [self.doubt]
        notes += [] if self.disagreement is None else [self.disagreement.sentence]
        heads = ("parameter", "MAP", "mean", "sd", "5 %", "95 %", "ESS", "R-hat")
        count = int(self.data.count)
        first = "" if self.caution is None else f"{self.caution};\n"
        return Table(f"{first}calibrated on {count} experiment{'s' if count > 1 else ''}; {state}", heads, rows, notes)


def fit(
    posterior: Posterior,
    data: Data,
    *,
    starts: int,
    settings: Settings,
    key: PRNGKeyArray,
    units: dict[str, str],
    errors: Sequence[Error] = (),
    start: Array | None = None,
    watch: Watch | None = None,
    seconds: float | None = None,
    support: "Support | None" = None,
    possible: Mapping[str, Range] | None = None,
) -> Fit:
    """Calibrate: MAP from several starts, then draws of the posterior around it.

    Arguments:
        posterior: prior and likelihood of the study.
        data: measured outputs.
        starts: number of starts of the MAP.
        settings: sizes of the sample, and by which sampler.
        key: of the random numbers.
        units: SI units of the parameters, for reports.
        errors: of the outputs: whether their noise may be autocorrelated, and whether the residual counts as error.
        start: parameters of the model (SI, without inferred errors) to start one of the searches from.
        watch: follows the calibration.
        seconds: budget of NUTS.
        support: the variables of a discrepancy of quantities.
        possible: physically possible range of each parameter of the model, SI, by name.
    """
    watch, points = watch or Watch(), posterior.starts(starts)
    if start is not None:
        points = points.at[0].set(known_start(posterior, data, start))
    declared, said = posterior, [f"{error.correlated} {error.inflate} {error.discrepancy}" for error in errors]
    name = f"maximum-{fingerprint(posterior.names, eqx.filter(posterior, eqx.is_array), data, points, said, support)}"
    if (kept := watch.recall(name)) is not None:
        posterior, data, maximum, process = read_back(posterior, data, kept, errors)
    else:
        watch.report("the most probable parameters")
        is_known = start is not None and len(points) == 1
        posterior, data, maximum, process = most_probable(posterior, data, points, errors, support, is_known)
        kept = (posterior.declared, posterior.population, data.weights, data.memory, process, maximum)
        watch.keep(name, arrays_of(kept))
    (there,) = expand(posterior, data, [np.asarray(maximum.u)])
    watch.fitted(np.asarray(there.predicted), data, posterior.groups)
    chains = draw(posterior, data, maximum, jnp.asarray(0.8), key, settings, watch, seconds)
    standardised = np.asarray(against_declared(declared, data, posterior, maximum.u, there.predicted, there.ok))
    chi2, p_value = left_unexplained(standardised, data, declared, noise_left(standardised, data, declared, errors))
    is_inflated = any(error.inflate for error in errors)
    told: dict[str, Any] = {"chi2_per_datum": chi2, "p_value": p_value, "is_inflated": is_inflated}
    if is_inflated:
        told["inflation"] = np.asarray(posterior.declared) / np.asarray(declared.declared)
    if process is not None:
        told |= {"discrepancy": process, "support": support}
    return Fit(posterior, data, maximum, chains, convergence(chains), units, possible=possible or {}, **told)


@program
def _of_members(posterior: Posterior, theta: Array, members: tuple[tuple[int, ...], ...]) -> tuple[Array, ...]:
    def one(theta):
        return posterior.population.of_members(theta, posterior.of_model(theta), np.asarray(members, dtype=int))

    return jax.vmap(jax.vmap(one))(theta)
