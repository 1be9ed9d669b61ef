"""The Python interface, first half: simulate, calibrate, compare, locate.  The command line does the same."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hsed_jax.analysis.draws import draws_of
from hsed_jax.config.schema import Study
from hsed_jax.criticism import compare as comparing
from hsed_jax.criticism import locate as locating
from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.locate import Location
from hsed_jax.criticism.prediction import Prediction, learned_misfit, predict
from hsed_jax.diagnosis.batch import Apart
from hsed_jax.errors import UserError
from hsed_jax.inference.fit import Fit, fit
from hsed_jax.inference.nuts import Settings
from hsed_jax.inference.searching import searched
from hsed_jax.inference.watch import Watch
from hsed_jax.measurements import Campaign, stop_at_errors
from hsed_jax.physics.batch import tiled_map
from hsed_jax.physics.effects import called
from hsed_jax.physics.names import of_each, owner_of
from hsed_jax.physics.outputs import further
from hsed_jax.physics.response import Response
from hsed_jax.physics.simulator import AbstractModel, Conditions
from hsed_jax.programs import program
from hsed_jax.study.advice import frequency_doubts
from hsed_jax.study.build import Built
from hsed_jax.tables import Table, Tabular

if TYPE_CHECKING:
    import xarray as xr

# Seed offset of a calibration; the steps of a design have the numbers below.
_CALIBRATION_KEY = 1_000_000
# Simulations of a batch that go to a thread together: one program for batches of any size, and bounded memory.
_CHUNK = 2048
_CHANNELS = ("elongation", "force", "energy")


@dataclass(frozen=True, repr=False)
class Calibration(Tabular):
    """A model calibrated on a campaign.

    Attributes:
        built: the study and its built parts.
        campaign: the experiments; those of the test split were not fitted.
        fit: MAP, draws and their convergence.

    Example:
        ```python
        fit = hx.calibrate(study, campaign)
        fit.map["A"]  # the most probable stiffness [N/m]
        fit.posterior  # the draws, a DataTree that ArviZ reads
        fit.predict().mean  # predictions of all experiments
        ```
    """

    built: Built
    campaign: Campaign
    fit: Fit

    @property
    def map(self) -> dict[str, float]:
        """θ_MAP by name, SI."""
        return self.fit.map

    @cached_property
    def posterior(self) -> "xr.DataTree":
        """Draws of the posterior (group `posterior`, SI) and statistics of the sampler (`sample_stats`), as ArviZ reads them.

        Example: `arviz.summary(fit.posterior)`.
        """
        import xarray as xr

        tree = xr.DataTree.from_dict(draws_of(self.fit))
        tree.attrs["study"] = self.built.study.study
        return tree

    def predict(self, campaign: Campaign | None = None) -> Prediction:
        """Predict the completed experiments of a campaign.

        Arguments:
            campaign: the experiments; by default those of the calibration, training and test.
        """
        campaign = self.campaign if campaign is None else campaign
        experiments = campaign.completed.experiments
        # Padded to the larger split of its own campaign, so that one program predicts both.
        size = max(len(experiments), len(self.campaign.train), len(self.campaign.test))
        return predict(
            self.fit, self.built.inference.data(campaign, experiments, size), self.built.experiments.taken(experiments)
        )

    def apart(self, campaign: Campaign) -> Apart | None:
        """The difference between the specimens of a campaign and their population, training specimens first; None
        without levels.
        """
        posterior = self.fit.posterior
        if not (levels := posterior.population.levels):
            return None
        data = self.built.inference.data(campaign, (*campaign.train.experiments, *campaign.test.experiments))
        theta, strangers = self.fit.maximum.theta, posterior.population.strangers(data.members, 1)
        own = np.asarray(posterior.by_experiment(theta, data, tuple(z[0] for z in strangers)))
        varying = {v.name: v for level in levels for v in level.varying}
        columns = [v.column for v in varying.values()]
        is_log = np.asarray([v.is_log for v in varying.values()])
        own, center = own[:, columns], np.asarray(posterior.of_model(theta))[columns]
        return Apart(tuple(varying), np.where(is_log, own / center, 1.0), np.where(is_log, 0.0, own - center))

    @cached_property
    def train(self) -> Prediction:
        """Predictions of the experiments that were fitted."""
        return self.predict(self.campaign.train)

    @cached_property
    def test(self) -> Prediction | None:
        """Predictions of the held-out experiments; None without them."""
        return self.predict(self.campaign.test) if len(self.campaign.test) else None

    def _table(self) -> Table:
        table = self.fit._table()
        said = [
            called(name, self.map, self.built.mechanics.catalogue) for name in dict.fromkeys(map(owner_of, self.map))
        ]
        signs = [f"with a negative amplitude: {words}" for words in said if words.endswith(")")]
        return replace(table, notes=[*table.notes, *signs, *frequency_doubts(self.built.mechanics, self.campaign)])


def campaign_of(study: Study) -> Campaign:
    """The experiments of a study: its campaign, or the measurements of its virtual laboratory at the initial design."""
    built = Built(study)
    return built.site.perform() if built.experiments.measured is None else built.experiments.measured


def calibrate(study: Study, campaign: Campaign | None = None) -> Calibration:
    """Calibrate the model of a study on the training experiments of a campaign.

    Arguments:
        study: the study.
        campaign: measured experiments; by default those of the study (`campaign_of`).

    Raises:
        UserError: the campaign does not fit the study, has errors in its data, or has nothing to fit.
    """
    campaign = campaign_of(study) if campaign is None else campaign
    built = Built(study, campaign)
    stop_at_errors(campaign, study.measurements.accepted(campaign))
    return calibrate_built(built, campaign)


def calibrate_built(
    built: Built,
    campaign: Campaign,
    size: int | None = None,
    start: Array | None = None,
    starts: int | None = None,
    watch: Watch | None = None,
    settings: Settings | None = None,
) -> Calibration:
    """`calibrate`, with the built study.

    Arguments:
        built: the study.
        campaign: the experiments.
        size: number of rows to pad the data to.
        start: parameters of the model (SI) to start one of the searches from.
        starts: number of searches of the MAP, by default that of the study.
        watch: follows it.
        settings: of the draws, by default those of the study.
    """
    study = built.study
    built.inference.check_told(len(campaign.train))
    posterior = built.inference.posterior
    data = built.inference.data(campaign, campaign.train.experiments, size)
    if start is None and built.inference.search:
        start = searched(posterior, data, built.inference.search, study.seed, watch)
    found = fit(
        posterior,
        data,
        starts=starts or study.calibration.starts,
        settings=settings or built.inference.settings,
        key=jax.random.fold_in(jax.random.key(study.seed), _CALIBRATION_KEY),
        units=built.mechanics.units,
        errors=built.observed.errors,
        start=start,
        watch=watch,
        seconds=study.calibration.seconds,
        support=built.inference.support,
        possible=built.inference.possible,
    )
    return Calibration(built, campaign, found)


def compare(calibration: Calibration, campaign: Campaign | None = None) -> Comparison:
    """The error of the calibrated model, compared with the noise.

    Arguments:
        calibration: the calibrated model.
        campaign: experiments to compare with; by default those it was calibrated on and their test split.
    """
    campaign = calibration.campaign if campaign is None else campaign
    if campaign is not calibration.campaign:
        calibration = replace(calibration, campaign=campaign)
    declared = calibration.fit.posterior.is_declared
    parameters = calibration.fit.posterior.fitted
    notes = [*calibration.fit.correlation_notes(), *calibration.built.experiments.thinning_notes(campaign)]
    notes += frequency_doubts(calibration.built.mechanics, campaign)
    if (
        calibration.built.experiments.component_test
        and calibration.built.simulation.grid is not None
        and not campaign.has_time
    ):
        notes.append(
            "the records have no time: the row number replaces it, which does not change a rate-independent law"
        )
    return comparing.compare(calibration.train, calibration.test, declared, parameters, notes)


def locate(
    calibration: Calibration, campaign: Campaign | None = None, *, split: Literal["train", "test"] = "train"
) -> Location:
    """Where the calibrated model fails.

    If the model discrepancy is learned, the misfit is located in it, because it has no noise. For quantities it covers all
    inputs instead of only the training experiments.

    Arguments:
        calibration: the calibrated model.
        campaign: experiments to look at; by default those it was calibrated on.
        split: of the campaign: the training experiments, as the command line does, or those held out.

    Raises:
        UserError: the campaign has no experiment of that split.
    """
    found = calibration.campaign
    campaign = found if campaign is None else campaign
    if campaign is not calibration.campaign:
        calibration = replace(calibration, campaign=campaign)
    if split == "train" and campaign is found:
        prediction = learned_misfit(calibration.fit, calibration.train)
    else:
        prediction = calibration.train if split == "train" else calibration.test
    if prediction is None:
        raise UserError(f"the campaign {campaign.name!r} has no experiments that were held out (split: test)")
    return locating.locate(prediction, campaign)


def simulate(
    study: Study,
    inputs: Mapping[str, Any],
    parameters: Mapping[str, Any] | None = None,
    channels: tuple[str, ...] | None = None,
) -> Response:
    """Simulate the model of a study under its excitation.

    Arguments:
        study: the study.
        inputs: variable inputs by name in their declared units, numbers or arrays of one common length: a batch.
        parameters: free parameters by name (SI), numbers or arrays; by default the medians of their priors.
        channels: histories to keep; by default elongation, force and energy of every specimen, if the model has them. An
            empty tuple keeps only quantities, which is faster.

    Returns:
        The response, with the quantities of Eq. 18 and those that the study names; in a batch every array has a leading axis.

    Raises:
        UserError: an input or parameter is missing or unknown, lengths differ, or the model does not have such a history.

    Example:
        >>> study = hx.load_study("study.yaml")
        >>> response = hx.simulate(study, {"V_P": 2.25, "T_P": 1.0}, {"A": 5e5, "beta": 1.0}, channels=())
        >>> round(float(response.quantities["peak_force"]) / 1e3)  # kN
        125
    """
    built = Built(study)
    free, _ = built.mechanics.parameters
    given = {**{name: float(prior.quantile(0.5)) for name, prior in free.items()}, **(parameters or {})}
    for what, names, known in (("input", inputs, built.study.inputs), ("parameter", given, free)):
        for name in names:
            if name not in known:
                raise UserError(f"there is no {what} {name!r}; the study has {', '.join(known) or 'none'}")
        if missing := [name for name in known if name not in names]:
            raise UserError(f"{what} {missing[0]!r} is missing; the study has {', '.join(known)}")
    factors = built.experiments.space.factors
    values = (
        {name: jnp.asarray(value, dtype=float) for name, value in given.items()},
        {name: jnp.asarray(value, dtype=float) * factors[name] for name, value in inputs.items()},
    )
    sizes = {leaf.shape for leaf in jax.tree.leaves(values)} - {()}
    if len(sizes) > 1 or any(len(shape) != 1 for shape in sizes):
        raise UserError(
            f"inputs and parameters must be numbers or arrays of one common length, but have the shapes {sizes}"
        )

    # The study may have records, but this simulation has none.
    parameters, inputs = values
    model, more = built.simulation.planned_simulator, further(tuple(study.quantities))
    if channels is None:
        channels = tuple(name for name in of_each(model.owners, _CHANNELS) if model.gives(name))
    if missing := [name for name in channels if not model.gives(name)]:
        raise UserError(f"channels: the model does not give {missing[0]}")
    if not sizes:
        return model.respond(parameters, Conditions(inputs), channels, more)
    ((size,),) = sizes
    if size == 0:
        raise UserError("there is nothing to simulate: inputs and parameters are arrays of length 0")
    batch = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (size,)), values)

    def chunk(begin: int) -> Response:
        count = min(_CHUNK, size - begin)
        part = jax.tree.map(lambda x: np.pad(x[begin : begin + count], (0, _CHUNK - count), mode="edge"), batch)
        found = _simulated(model, channels, more, part, jnp.asarray(count))
        return jax.tree.map(lambda x: np.asarray(x)[:count], found)

    # On all cores.  The first simulation compiles while the others wait.
    with ThreadPoolExecutor() as threads:
        parts = list(threads.map(chunk, range(0, size, _CHUNK)))
    return jax.device_put(jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts))


@program
def _simulated(
    model: AbstractModel, channels: tuple[str, ...], quantities: tuple[str, ...], values: Any, count: Array
) -> Response:
    def one(simulation):
        parameters, inputs = simulation
        return model.respond(parameters, Conditions(inputs), channels, quantities)

    found = tiled_map(jax.vmap(one), values, count=count)
    return found._replace(ok=found.ok.astype(bool))
