r"""The worth of earlier experiments for planned ones, before a calibration.

The model is linearised in the middle of the priors, along coordinates w in which the prior is standard normal.  An experiment
with the Jacobian J of its outputs over their noise leaves the covariance of the parameters, and a planned output with the
gradient g the variance

$$C = \Big(I + \sum J^\top J\Big)^{-1},\qquad v = g^\top C\,g,$$

and the prior alone gives $g^\top g$.  The planned experiments are spread over the inputs.  The worth of experiments is the
share of the variance that they remove: for each output over all planned experiments together, then the mean over the outputs.
It does not include an error of the model: for another specimen, or for a wrong model, the true worth is smaller.

Source: Bayesian linear design, Chaloner & Verdinelli (1995), doi:10.1214/ss/1177009939.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.stats import norm

from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Data, data_of
from hsed_jax.inference.simulations import linearised_at
from hsed_jax.measurements import Campaign
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.inference import Inference
from hsed_jax.tables import Table, Tabular

PLANNED = 64
"""Planned experiments that represent all inputs."""

# Half the difference along a standard normal coordinate.
_STEP = 1e-3


@dataclass(frozen=True, repr=False)
class Worth(Tabular):
    """The worth of experiments for planned ones, as shares of the prior variance of the planned ones.

    Attributes:
        experiments: which.
        alone: removed by each without the others.
        lost: removed by all, minus the share that the others remove without this one.
        together: removed by all.
        by_output: the same, of each output.
    """

    experiments: Sequence[str]
    alone: Float[np.ndarray, " n"]
    lost: Float[np.ndarray, " n"]
    together: float
    by_output: dict[str, float]

    @property
    def sentence(self) -> str:
        """The worth of all experiments together, and the experiment with the largest worth."""
        count, best = len(self.experiments), int(np.argmax(self.alone))
        which = "1 earlier experiment removes" if count == 1 else f"{count} earlier experiments remove"
        most = "" if count == 1 else f"; {self.experiments[best]} alone removes {_percent(self.alone[best])}"
        outputs = ", ".join(f"{name} {_percent(share)}" for name, share in self.by_output.items())
        each = f" ({outputs})" if len(self.by_output) > 1 else ""
        return (
            f"{which} {_percent(self.together)} of the variance that the priors give the planned experiments{each}{most}, if the "
            "model is right"
        )

    def _table(self) -> Table:
        rows = [
            (name, _percent(alone), _percent(lost))
            for name, alone, lost in zip(self.experiments, self.alone, self.lost, strict=True)
        ]
        return Table(self.sentence, ("experiment", "alone", "lost without it"), rows)


def worth_of(inference: Inference, campaign: Campaign) -> Worth:
    """The worth of the completed training experiments of a campaign for the planned experiments of a study.

    Arguments:
        inference: of the study.
        campaign: earlier experiments, with the inputs of the study.

    Raises:
        UserError: the study plans nothing that can be simulated, the campaign has other inputs or no completed experiment, or
            a simulation diverges in the middle of the priors.
    """
    experiments, space = campaign.train.experiments, inference.experiments.space
    where = campaign.source or campaign.name
    if not space.names or inference.simulation.grid is not None:
        raise UserError(
            "--worth: the study plans no experiments that can be simulated; give inputs, and an excitation that depends on them"
        )
    if inference.study.model.levels:
        raise UserError("--worth: a study with model.levels plans no experiments")
    if not experiments:
        raise UserError(f"{where}: there is no completed training experiment")
    if set(campaign.inputs) != set(space.names):
        raise UserError(
            f"{where}: it has the inputs {', '.join(campaign.inputs) or 'none'}; the study has {', '.join(space.names)}"
        )
    posterior, data = inference.posterior, inference.data(campaign, experiments)
    inputs = space.si(space.declared(space.spread(PLANNED)))
    shape = PLANNED, len(posterior.groups)
    planned = data_of(
        Conditions({name: jnp.asarray(values) for name, values in inputs.items()}),
        np.ones(shape),
        np.zeros(shape, dtype=bool),
        np.full(shape, np.inf),
        PLANNED,
    )
    middle, slope = _middle(inference)
    predicted, along = _linearised(inference, data, middle, slope)
    _, ahead = _linearised(inference, planned, middle, slope)
    sigma = np.asarray(posterior.expected_sigma(posterior.constrain(jnp.asarray(middle)), jnp.asarray(predicted), data))
    root = np.where(np.asarray(data.weights) > 0, 1 / np.where(sigma > 0, sigma, np.inf), 0.0)
    scaled = along * root[..., None]
    information = np.einsum("njp,njq->npq", scaled, scaled)[: len(experiments)]
    removed = [_removed(one, ahead, posterior.groups) for one in information]
    total = information.sum(axis=0)
    together = _removed(total, ahead, posterior.groups)
    others = [_removed(total - one, ahead, posterior.groups).mean() for one in information]
    return Worth(
        [experiment.id for experiment in experiments],
        np.asarray([one.mean() for one in removed]),
        together.mean() - np.asarray(others),
        float(together.mean()),
        dict(zip(inference.observed.outputs, map(float, together), strict=True)),
    )


def _removed(
    information: Float[np.ndarray, "p p"], along: Float[np.ndarray, "m J p"], groups: Int[np.ndarray, " J"]
) -> Float[np.ndarray, " outputs"]:
    """The share of the variance of each output that information removes."""
    root = np.linalg.cholesky(np.eye(len(information)) + information)
    left = np.linalg.solve(root, np.moveaxis(along, -1, 0).reshape(len(root), -1)).reshape(len(root), *along.shape[:2])
    before, after = (along**2).sum(axis=(0, 2)), (left**2).sum(axis=(0, 1))
    members = groups[None] == np.arange(groups.max() + 1)[:, None]
    whole = members @ before
    return 1 - (members @ after) / np.where(whole > 0, whole, 1.0)


def _middle(inference: Inference) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """The middle of the priors in u, and the derivative of u along standard normal coordinates there."""
    posterior = inference.posterior
    shares = norm.cdf(np.asarray([[0.0], [_STEP], [-_STEP]])) * np.ones(len(posterior.reported))
    middle, ahead, behind = np.asarray(posterior.at_shares(shares))
    return middle, (ahead - behind) / (2 * _STEP)


def _linearised(
    inference: Inference, data: Data, middle: Float[np.ndarray, " p"], slope: Float[np.ndarray, " p"]
) -> tuple[Float[np.ndarray, "n J"], Float[np.ndarray, "n J p"]]:
    """Outputs in the middle of the priors, SI, and their derivatives along standard normal coordinates.

    Raises:
        UserError: a simulation diverges.
    """
    outputs, ok, along = linearised_at(inference.posterior, data, middle[None], 1)
    count = int(data.count)
    if not np.all(ok[0][:count] > 0):
        many = int(np.sum(ok[0][:count] <= 0))
        raise UserError(
            f"--worth: {many} of {count} simulations diverge in the middle of the priors; narrow the priors"
        )
    return outputs[0], along[0] * slope


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %" if share < 0.995 else f"{100 * share:.4g} %"
