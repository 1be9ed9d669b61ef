"""Prior prediction: a test before the calibration whether a model can produce the measured data.

The model is simulated at points spread over its priors. Measurements outside the envelope of these simulations, by more than
three standard deviations of the declared noise, are not explained by any parameters of the priors.  The distance is a
normalised error: the RMS distance to the envelope over the RMS of the measurement about its mean, or over the magnitude of a
quantity.  No simulation within the envelope has a smaller error.

An envelope shows only what is impossible: every single simulation may differ from a measurement inside it.

Source: prior predictive checks, Gelman, Simpson & Betancourt (2017), doi:10.3390/e19100555.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from hsed_jax.inference.log_densities import simulated
from hsed_jax.inference.watch import Watch
from hsed_jax.measurements import Campaign, Experiment
from hsed_jax.physics.display import shown
from hsed_jax.physics.pairs import Pair
from hsed_jax.study.inference import Inference

DRAWS = 64
"""Number of simulated points of the priors."""

# Allowed distance from the envelope, in standard deviations of the noise.
_NOISE = 3.0
# Errors outside the envelope above this exceed the noise and the usual error of a formula.
_OUTSIDE = 0.1
# Number of experiments without a doubt that are named.
_NAMED = 6


@dataclass(frozen=True)
class Reach:
    """One output of one experiment, compared with the predictions of the priors.

    Attributes:
        experiment, output: which.
        error: normalised RMS distance from the envelope, beyond the noise; zero inside it.
        share: of the samples that are outside.
        time: of the sample that is farthest outside [s]; None of a quantity, or without a time.
        measured: there, SI.
        low, high: least and largest prediction there, SI.
    """

    experiment: str
    output: str
    error: float
    share: float
    time: float | None
    measured: float
    low: float
    high: float

    @property
    def is_outside(self) -> bool:
        """Whether the priors exclude the data."""
        return self.error > _OUTSIDE

    def sentence(self, pair: Pair) -> str:
        """In words, in the units of the campaign."""
        divisor, unit = shown(pair, self.output, np.asarray([self.measured, self.low, self.high]))
        low, high, measured = (f"{value / divisor:.3g}" for value in (self.low, self.high, self.measured))
        name, unit = pair.called(self.output), "" if unit == "1" else f" {unit}"
        at = "" if self.time is None else f" at {self.time:.4g} s"
        many = (
            "" if self.share == 1.0 and self.time is None else f" in {100 * self.share:.0f} % of its samples, most{at}"
        )
        return (
            f"{self.experiment}: the model cannot produce the measured {name} with these priors: it is outside all predictions"
            f"{many} (measured {measured}{unit}, predicted {low} to {high}{unit}); "
            f"the error of {name} stays above {self.error:.2g}"
        )


def prior_reach(inference: Inference, campaign: Campaign) -> tuple[list[Reach], int]:
    """The measurements, compared with the envelope of simulations over the priors.

    Arguments:
        inference: of the study.
        campaign: measured experiments; those with a result are simulated.

    Returns:
        Every measured output of every experiment, and the number of points of the priors with converged simulations of all
        experiments.
    """
    from scipy.stats import qmc

    experiments = inference.experiments.taken(campaign.completed.experiments)
    posterior, data = inference.posterior, inference.data(campaign, campaign.completed.experiments)
    shares = qmc.Sobol(len(posterior.reported), rng=np.random.default_rng(inference.study.seed)).random(DRAWS)
    points = np.asarray(posterior.at_shares(np.clip(shares, 1e-6, 1 - 1e-6)))
    outputs, ok, _ = simulated(posterior, data, points, Watch())
    count = int(data.count)
    values, used = np.asarray(data.values)[:count], np.asarray(data.weights)[:count] > 0
    middle = posterior.constrain(jnp.asarray(points[0]))
    sigma = np.asarray(posterior.expected_sigma(middle, data.values, data))[:count]
    # An inferred error is unknown before the calibration.
    sigma = np.where(posterior.is_declared[posterior.groups], sigma, 0.0)
    kept = ok[:, :count] > 0
    found = [
        reach
        for row, experiment in enumerate(experiments)
        for reach in _of_experiment(
            experiment,
            inference.observed.outputs,
            posterior.groups,
            values[row],
            used[row],
            sigma[row],
            outputs[kept[:, row], row],
        )
    ]
    return found, int(kept.all(axis=1).sum())


def _of_experiment(
    experiment: Experiment,
    names: Sequence[str],
    groups: np.ndarray,
    values: Float[np.ndarray, " J"],
    used: Bool[np.ndarray, " J"],
    sigma: Float[np.ndarray, " J"],
    outputs: Float[np.ndarray, "S J"],
) -> list[Reach]:
    """Every output of an experiment, compared with its converged predictions."""
    found = []
    for number, name in enumerate(names):
        own = np.flatnonzero(groups == number)
        columns = own[used[own]]
        if not columns.size or not len(outputs):
            continue
        measured, predicted = values[columns], outputs[:, columns]
        low, high = predicted.min(axis=0), predicted.max(axis=0)
        beyond = np.maximum(measured - high, low - measured) - _NOISE * sigma[columns]
        outside = np.maximum(beyond, 0.0)
        about = measured - measured.mean() if measured.size > 1 else measured
        size = float(np.sqrt(np.mean(about**2)))
        error = float(np.sqrt(np.mean(outside**2)))
        most = int(np.argmax(beyond))
        time = None
        if own.size > 1 and experiment.record is not None:
            time = float(experiment.record.time[int(columns[most] - own[0])])
        found.append(
            Reach(
                experiment.id,
                name,
                error / size if size > 0 else float(error > 0),
                float(np.mean(outside > 0)),
                time,
                float(measured[most]),
                float(low[most]),
                float(high[most]),
            )
        )
    return found


def prior_sentences(inference: Inference, campaign: Campaign) -> list[str]:
    """Sentences on the measured data that the priors exclude, and on those that they do not exclude."""
    found, converged = prior_reach(inference, campaign)
    said = [reach.sentence(campaign.pair) for reach in found if reach.is_outside]
    for output in inference.observed.outputs:
        inside = [reach.experiment for reach in found if reach.output == output and not reach.is_outside]
        if inside:
            more = f" and {len(inside) - _NAMED} more" if len(inside) > _NAMED else ""
            name = campaign.pair.called(output)
            said.append(
                f"{', '.join(inside[:_NAMED])}{more}: the measured {name} is within the predictions of the priors"
            )
    if converged < DRAWS:
        said.append(f"{DRAWS - converged} of {DRAWS} simulations at points of the priors diverged in some experiment")
    return said
