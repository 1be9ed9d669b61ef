"""The outputs of an experiment that are compared with the model: its quantities, or its histories.

An observation predicts its outputs for one experiment, and converts measured experiments into padded `Data`. Outputs are
columns; columns that share an error (all samples of a channel) form a group.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Data, data_of
from hsed_jax.measurements import Campaign, Experiment, Record
from hsed_jax.measurements.characteristics import from_unloaded
from hsed_jax.physics.excitations import AbstractExcitation, Applied, Imposed, Tabulated
from hsed_jax.physics.outputs import driven_mass, is_driver
from hsed_jax.physics.simulator import AbstractModel, Conditions, Recorded

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

# The motion has a corner if two estimates of a slope differ by this share of the slopes nearby.
_CORNER = 0.2
# Steps of an interval in which an imposed elongation turns, if its path is this share of the largest change of a step.
_AT_A_TURN, _TURN = 8, 0.01

Excite = Callable[[Mapping[str, Any]], AbstractExcitation] | None
Respond = Callable[[Mapping[str, Any], Conditions], tuple[Float[Array, " J"], Array]]


@dataclass(frozen=True)
class Grid:
    """The grid of recorded experiments.

    Attributes:
        samples: of a history; shorter records are padded.
        every: integration steps from one sample to the next.
        change: for an imposed elongation, the largest change in one step [m]: each interval then has its own number of steps,
            and `every` is 1; None where every interval has as many.
        steps: of the integration; a record that needs fewer is padded with steps of length zero.
        from_zero: whether an imposed record that begins loaded gets a sample before it; a model that is a function gets the
            unchanged record.
    """

    samples: int
    every: int
    change: float | None = None
    steps: int = 0
    from_zero: bool = True

    def __post_init__(self):
        """Count the steps where every interval has as many."""
        if self.change is None:
            object.__setattr__(self, "steps", self.every * (self.samples - 1))

    def divisions(self, record: Record) -> np.ndarray:
        """Steps of each interval of a record, (len(record) − 1,)."""
        if self.change is None:
            return np.full(len(record) - 1, self.every)
        if not (len(record) > 1 and np.isfinite(record["elongation"]).all() and np.all(np.diff(record.time) > 0)):
            return np.ones(len(record) - 1, dtype=int)  # an error is raised if the motion is requested
        shares = np.arange(_AT_A_TURN + 1) / _AT_A_TURN
        moved = np.diff(_curve(record)(record.time[:-1, None] + np.diff(record.time)[:, None] * shares), axis=1)
        path = np.abs(moved).sum(axis=1)
        # With a tolerance: the intervals of a ramp have equal numbers of steps.
        divisions = np.maximum(np.ceil(path / self.change - 1e-9), 1).astype(int)
        # At a reversal the force of a spring has a kink.  Reversals by noise are small.
        turns = (moved[:, 1:] * moved[:, :-1] < 0).any(axis=1) & (path > _TURN * self.change)
        divisions[turns] = np.maximum(divisions[turns], _AT_A_TURN)
        return divisions


@dataclass(frozen=True)
class Quantities:
    """The named quantities of each experiment, one column each.

    Attributes:
        names: of the quantities.
        grid: where the excitation is recorded; None where the inputs define it.
        excitation: from inputs to the excitation of an experiment, for records without it.
        masses: number of masses of the structure.
    """

    names: tuple[str, ...]
    grid: Grid | None = None
    excitation: Excite = None
    masses: int = 0

    @property
    def groups(self) -> np.ndarray:
        """Group of each column, (J,)."""
        return np.arange(len(self.names))

    def respond(self, model: AbstractModel) -> Respond:
        """From parameters by name and conditions to the outputs (J,) and whether the simulation converged."""
        return lambda parameters, conditions: model.quantities(parameters, conditions, self.names)

    def measured(self, experiment: Experiment) -> np.ndarray:
        """The measured outputs of one experiment, SI, (J,); NaN without one."""
        return np.asarray([experiment.quantity(name, self.masses) for name in self.names])

    def weights(self, experiment: Experiment) -> np.ndarray:
        """1 where there is a measurement to use, (J,)."""
        return np.isfinite(self.measured(experiment)).astype(float)

    def gaps(self, time: np.ndarray | None) -> np.ndarray:
        """Time since the previous sample [s], (J,): none, a quantity has no sample before it."""
        return np.full(len(self.names), np.inf)


@dataclass(frozen=True)
class Histories:
    """The histories of the named channels at the times of the record, channel after channel.

    Attributes:
        names: of the channels.
        samples: of the longest record.
        grid: where the excitation is recorded; None where the inputs define it and all records share the times of the
            model's timeline.
        excitation: from inputs to the excitation of an experiment, for records without it.
    """

    names: tuple[str, ...]
    samples: int
    grid: Grid | None = None
    excitation: Excite = None

    @property
    def groups(self) -> np.ndarray:
        """Group of each column, (J,)."""
        return np.repeat(np.arange(len(self.names)), self.samples)

    def respond(self, model: AbstractModel) -> Respond:
        """From parameters by name and conditions to the outputs (J,) and whether the simulation converged."""

        def respond(parameters, conditions):
            response = model.respond(parameters, conditions, self.names)
            return jnp.concatenate([response.channels[name] for name in self.names]), response.ok

        return respond

    def measured(self, experiment: Experiment) -> np.ndarray:
        """The measured outputs of one experiment, SI, (J,); NaN beyond the record."""
        record = _record(experiment)
        columns = np.full((len(self.names), self.samples), np.nan)
        for row, name in zip(columns, self.names, strict=True):
            if name in record.channels:
                row[: len(record)] = record[name]
        return columns.ravel()

    def weights(self, experiment: Experiment) -> np.ndarray:
        """1 where there is a measurement within the window, (J,)."""
        inside = np.zeros(self.samples)
        inside[: len(_record(experiment))] = experiment.in_window
        return np.isfinite(self.measured(experiment)) * np.tile(inside, len(self.names))

    def gaps(self, time: np.ndarray | None) -> np.ndarray:
        """Time since the previous sample of the same channel [s], (J,), infinite for the first and beyond the record.

        Arguments:
            time: of the record's samples; None where all have the timeline's own.
        """
        gaps = np.full((len(self.names), self.samples), np.inf)
        steps = np.ones(self.samples - 1) if time is None else np.diff(time)
        gaps[:, 1 : len(steps) + 1] = steps
        return gaps.ravel()


Observation = Quantities | Histories


@final
class Outputs(eqx.Module):
    """From a parameter vector and the conditions of one experiment to its observed outputs.

    The differences between two studies of the same kind (masses, scales) are arrays in it, and thus operands of its compiled
    programs: a process with a hundred campaigns compiles once.

    Arguments:
        model: the computational model.
        observation: selects the outputs of a response.
        names: of the parameters, in the order of a parameter vector.
    """

    model: AbstractModel
    observation: Observation = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, model: AbstractModel, observation: Observation, names: tuple[str, ...]):
        self.model = jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, model)
        # The static parts identify a program: without the ground motion they are equal for studies of one kind.
        self.observation = dataclasses.replace(observation, grid=None, excitation=None)
        self.names = names

    def __call__(self, theta: Float[Array, " p"], conditions: Conditions) -> tuple[Float[Array, " J"], Array]:
        """Outputs (J,) and whether the simulation converged."""
        return self.observation.respond(self.model)(dict(zip(self.names, theta, strict=True)), conditions)


def assemble(
    observation: Observation,
    campaign: Campaign,
    experiments: Sequence[Experiment],
    relative: np.ndarray,
    size: int | None = None,
) -> Data:
    """Measured experiments as padded data.

    Arguments:
        observation: of the study.
        campaign: where the experiments come from (its protocol and units).
        experiments: which of them, in order.
        relative: per output, whether its error is relative.
        size: number of rows to pad to; by default as many as there are experiments.

    Raises:
        UserError: there is nothing to fit, an experiment lacks data of its excitation, or an error is relative to zero.
    """
    if not experiments:
        raise UserError(f"the campaign {campaign.name!r} has no completed experiment to use here")
    rows = [*experiments, *[experiments[-1]] * ((size or len(experiments)) - len(experiments))]
    conditions = [conditions_of(e, campaign, observation.grid, observation.excitation) for e in rows]
    measured = np.stack([observation.measured(e) for e in rows])
    used = np.stack([observation.weights(e) > 0 for e in rows])
    if not used[: len(experiments)].any():
        raise UserError(
            f"the campaign {campaign.name!r}: none of {', '.join(observation.names)} was measured in "
            f"{', '.join(e.id for e in experiments)}"
        )
    of_relative = np.asarray(relative)[observation.groups]
    for e, row, own in zip(experiments, measured, used, strict=False):
        for output in np.unique(observation.groups[own & of_relative]):
            name, values = observation.names[output], row[own & (observation.groups == output)]
            if not values.any() or (values.size == 1 and values[0] < 0):
                raise UserError(
                    f"experiment {e.id!r}: {name} is {values[0]:g}, for which a relative error is zero; give {name} an "
                    "absolute error"
                )
    gaps = np.stack([observation.gaps(None if e.record is None else e.record.time) for e in rows])
    data = data_of(stacked(conditions), measured, used, gaps, len(experiments))
    if len(rows) > len(experiments):
        return data  # a padded program keeps its shapes while experiments are added
    return data._replace(first=jnp.asarray(first_alike(data.conditions)))


def conditions_of(experiment: Experiment, campaign: Campaign, grid: Grid | None, excitation: Excite) -> Conditions:
    """Inputs and recorded excitation of one experiment."""
    inputs = jax.device_put({name: np.asarray(value, dtype=float) for name, value in experiment.inputs.items()})
    if grid is None:
        return Conditions(inputs)
    record = _record(experiment)
    if len(record) > grid.samples:
        raise UserError(
            f"experiment {experiment.id!r}: its record has {len(record)} samples, more than the {grid.samples} that the "
            "model was built for; calibrate on a campaign that holds it (as a test experiment)"
        )
    is_imposed = campaign.protocol == "displacement" and (record.channels or excitation is None)
    moved = from_unloaded(record) if is_imposed and grid.from_zero else record
    divisions = grid.divisions(moved)
    if (steps := int(divisions.sum())) > grid.steps:
        raise UserError(
            f"experiment {experiment.id!r}: its record takes {steps} steps, more than the {grid.steps} that the model was "
            "built for; calibrate on a campaign that holds it (as a test experiment)"
        )
    lengths, half_steps, ends = _grid_of(moved.time, divisions, grid, len(record))
    measured = [name for name in record.channels if is_driver(name)]
    # A possible experiment has times, but no measurement.
    if is_imposed:
        samples: Any = _imposed(moved, half_steps, experiment.id)
    elif measured:
        samples = _driven(record, half_steps, measured)
    elif excitation is not None:
        samples = _sampled(excitation(inputs), jnp.asarray(half_steps - record.time[0]))
    else:
        raise UserError(
            f"experiment {experiment.id!r}: its record has no ground_acceleration and the study no excitation; give one (or "
            "the force on mass 1 as a channel applied_force_1)"
        )
    placed = jax.device_put((samples, lengths, ends, np.asarray(steps)))
    return Conditions(inputs, Recorded(Tabulated(placed[0]), *placed[1:]))


@eqx.filter_jit
def _sampled(excitation: AbstractExcitation, times: Float[Array, " k"]) -> Any:
    return jax.vmap(excitation.sample)(times)


def _record(experiment: Experiment) -> Record:
    if experiment.record is None:
        raise UserError(f"experiment {experiment.id!r} has no record; histories and recorded motions need one")
    return experiment.record


def _grid_of(
    time: np.ndarray, divisions: np.ndarray, grid: Grid, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step lengths (steps,), the times of the half-step grid (2·steps+1,), and after how many steps each sample is (samples,).

    Samples are the last `count` of the times.  Padded steps have length zero, and padded samples are at the end.
    """
    lengths = np.zeros(grid.steps)
    lengths[: divisions.sum()] = np.repeat(np.diff(time) / divisions, divisions)
    ends = np.full(grid.samples, grid.steps)
    ends[:count] = np.concatenate([[0], np.cumsum(divisions)])[-count:]
    return lengths, time[0] + np.concatenate([[0.0], np.cumsum(np.repeat(lengths / 2, 2))]), ends


def _driven(record: Record, times: np.ndarray, measured: Sequence[str]) -> Any:
    """The measured ground acceleration by itself, or with the measured forces on masses."""
    samples = {name: _between(record, times, name) for name in measured}
    ground = samples.pop("ground_acceleration", None)
    forces = {mass - 1: force for name, force in samples.items() if (mass := driven_mass(name)) is not None}
    return Applied(forces, ground) if forces else ground


def _between(record: Record, times: np.ndarray, name: str) -> np.ndarray:
    """A measured channel between its samples: a cubic spline.  Straight lines would reduce the peaks by 2 % at 16 samples to
    a period.
    """
    from scipy.interpolate import CubicSpline

    if len(record) < 4:
        return np.interp(times, record.time, record[name])
    return CubicSpline(record.time, record[name])(np.minimum(times, record.time[-1]))


def _imposed(record: Record, times: np.ndarray, name: str) -> Imposed:
    """The measured elongation between its samples, and its rate."""
    if "elongation" not in record.channels:
        raise UserError(f"experiment {name!r}: the protocol is displacement, but its record has no elongation")
    if len(record) < 2:
        raise UserError(f"experiment {name!r}: its record has one sample; an imposed elongation needs at least two")
    if not (np.isfinite(record["elongation"]).all() and np.all(np.diff(record.time) > 0)):
        raise UserError(
            f"experiment {name!r}: an imposed elongation must be finite numbers at increasing times (hsed check says where)"
        )
    curve = _curve(record)
    inside = np.minimum(times, record.time[-1])
    return Imposed(curve(inside), curve.derivative()(inside))


def _curve(record: Record) -> "CubicHermiteSpline":
    """The measured elongation between its samples, by cubics.

    Their slopes are those of a spline, which finds the rate and the reversals of a smooth motion between the samples.  At a
    corner of the motion a spline would oscillate; there the slopes are those of Akima (modified), for which a ramp stays
    straight.
    """
    from scipy.interpolate import Akima1DInterpolator, CubicHermiteSpline, CubicSpline

    time, elongation = record.time, record["elongation"]
    slopes = Akima1DInterpolator(time, elongation, method="makima")(time, 1)
    if len(record) >= 4:
        smooth = CubicSpline(time, elongation)(time, 1)
        secants = np.pad(np.abs(np.diff(elongation) / np.diff(time)), 2, mode="edge")
        nearby = np.max([secants[k : k + len(time)] for k in range(4)], axis=0)
        slopes = np.where(np.abs(smooth - slopes) < _CORNER * nearby, smooth, slopes)
    return CubicHermiteSpline(time, elongation, slopes)


def stacked(conditions: Sequence[Conditions]) -> Conditions:
    """Conditions of several experiments, leading axis n."""
    stacks = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *conditions)
    return jax.device_put(stacks)


def first_alike(conditions: Conditions) -> Int[np.ndarray, " n"]:
    """For each experiment, the first one with the same conditions: several windows of one record have one simulation.

    Arguments:
        conditions: of n experiments, leading axis n.
    """
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(conditions)]
    firsts: dict[tuple[bytes, ...], int] = {}
    return np.asarray(
        [firsts.setdefault(tuple(leaf[k].tobytes() for leaf in leaves), k) for k in range(len(leaves[0]))]
    )
