"""The large model of a diagnosis: the model of a study with every candidate effect, for a campaign."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from hsed_jax.behaviour.histories import Range, range_of
from hsed_jax.config.schema import ImproveEntry, ScalesEntry, Study
from hsed_jax.criticism.compare import compare
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.criticism.shown_noise import HISTORY
from hsed_jax.diagnosis.batch import Batch, Part
from hsed_jax.diagnosis.box import Box
from hsed_jax.diagnosis.measured import Measured
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import FormColumns, Problem
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.observation import Histories, conditions_of, stacked
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import Campaign, Experiment, Record
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.effects.forms import default_form
from hsed_jax.physics.effects.shaped import shapes_of
from hsed_jax.physics.excitations import AbstractExcitation
from hsed_jax.physics.names import own_name, owner_of
from hsed_jax.physics.outputs import is_driver
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.physics.simulator import Conditions, Simulator
from hsed_jax.physics.timeline import Timeline, times
from hsed_jax.sections import DRIVER, FORM
from hsed_jax.study.build import Built
from hsed_jax.study.laboratories import driver_of
from hsed_jax.study.plan import ORDER, check_added
from hsed_jax.study.specimens import effects_of

# Number of candidate experiments, among which the diagnosis searches for the one that separates rivals best.
_CANDIDATES = 32
# Larger than any noise, in units of an output; its reciprocal is smaller than any noise.
_ANY_NOISE = 1e12
# Number of reversals of the cycles that replace a history without a measurement.
_REVERSALS = 21
# The number of conditions is padded to a multiple of this, so that campaigns of similar size share a compiled program.
_PADDING = 16


def applicable(built: Built, campaign: Campaign) -> list[str]:
    """Effects of the catalogue that the model does not have and that the measurements can show."""
    has_time = campaign.has_time or not built.experiments.component_test or built.simulation.grid is None
    is_shaken = "ground_acceleration" in drivers(built, campaign)
    quantities = built.study.observe == "quantities"
    return [
        name
        for name in built.mechanics.naming.candidates
        if name not in effects_of(built.study)
        and not built.mechanics.naming.unserved(name)
        and (has_time or not built.mechanics.catalogue[name].needs_time)
        and not (quantities and built.mechanics.catalogue[name].histories_only)
        and not (built.experiments.component_test and built.mechanics.catalogue[name].shaken_only)
        and (is_shaken or not built.mechanics.catalogue[name].ground_only)
    ]


def drivers(built: Built, campaign: Campaign) -> list[str]:
    """Channels that measure the excitation of the structure; without any, the channel that would measure it."""
    return [name for name in campaign.channels if is_driver(name) and name != "time"] or [driver_of(built.study)]


def with_effects(built: Built, effects: Sequence[str], forms: Mapping[str, str] | None = None) -> Study:
    """The study with these effects added to its model, with the priors of the catalogue and with unchanged scales.

    Arguments:
        built: the study.
        effects: names of effects.
        forms: labels of their forms, unless these are the default forms.

    Raises:
        UserError: an effect does not exist, the model has it already, or it occurs twice.
    """
    study = built.study
    check_added(study, effects, built.mechanics.naming)
    added = {name: _said(built, name, (forms or {}).get(name)) for name in effects}
    model = study.model.model_copy(update={"effects": {**study.model.effects, **added}})
    # The study can be improved again: its settings of the improvement are reset, and the next diagnosis selects the effects.
    steps = [step for step in ORDER if step in study.steps or (step == "diagnose" and "improve" in study.steps)]
    larger = study.model_copy(update={"model": model, "steps": steps, "improve": ImproveEntry()})
    scales = Built(larger, built.campaign).simulation.scales
    return larger.model_copy(update={"scales": ScalesEntry(**scales._asdict())})


def _said(built: Built, effect: str, label: str | None) -> dict[str, str]:
    """A form in the format of a study."""
    form = (
        default_form(built.mechanics.catalogue[effect])
        if label is None
        else built.mechanics.naming.forms(effect).get(label)
    )
    if form is None:
        raise UserError(
            f"there is no form {label!r} of {effect}; it has {', '.join(built.mechanics.naming.forms(effect))}"
        )
    return {key: word for key, word in ((FORM, form.name), (DRIVER, form.driver)) if word and not form.is_default}


def problem_of(
    built: Built,
    campaign: Campaign,
    effects: Sequence[str] | None = None,
    cube: np.ndarray | None = None,
    forms: Mapping[str, str] | None = None,
    samples: int | None = None,
) -> Problem:
    """The large model and the measurements.  It does not need a calibration (`Problem.calibrated`).

    Arguments:
        built: the study.
        campaign: its experiments.
        effects: candidates; by default all applicable effects.
        cube: inputs of candidate experiments in the unit cube, (c, d); by default points that fill the cube.
        forms: by effect, the label of its only allowed form; by default all forms of an effect are allowed.
        samples: number of samples to which longer records of component tests are thinned, if the setting of the study is larger.
    """
    if samples is not None and samples < built.study.measurements.samples:
        fewer = built.study.measurements.model_copy(update={"samples": samples})
        built = replace(built, study=built.study.model_copy(update={"measurements": fewer}))
    names = applicable(built, campaign) if effects is None else list(effects)
    large = Built(with_effects(built, names), built.campaign, open_forms=tuple(names))
    free, _ = large.mechanics.parameters
    data = large.inference.data(campaign, (*campaign.train.experiments, *campaign.test.experiments))
    train, test = (
        large.experiments.taken(campaign.train.experiments),
        large.experiments.taken(campaign.test.experiments),
    )
    inputs, further = _candidates(large, campaign, cube)
    joined: list[Conditions] = [data.conditions] if further is None else [data.conditions, further]
    conditions = _padded(jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *joined))
    catalogue, order = built.mechanics.catalogue.only(names), tuple(free)
    declared = _declared(free, catalogue)
    neutral = _neutral(free, declared)
    own = {name: _forms(large, name, order, (forms or {}).get(name)) for name in names}
    columns = {n: np.asarray([k for k, one in enumerate(order) if owner_of(one) == n], dtype=int) for n in names}
    parts = [
        Part(
            name, k, neutral[k], np.asarray([own_name(order[one]) in shapes_of(catalogue[name]) for one in map(int, k)])
        )
        for name, k in columns.items()
    ]
    size = jax.tree.leaves(conditions)[0].shape[0]
    weights = np.asarray(data.weights)
    used = np.concatenate([weights > 0, np.zeros((size - len(weights), weights.shape[1]), dtype=bool)])
    kept = _kept(large, (*train, *test))
    batch = Batch(large.simulation.simulator, large.inference.observation, order, conditions, parts, used, kept)
    # A prior may exceed the physical limits of a parameter: values beyond them belong to another effect.
    box = Box(free, limits={name: (known.lower, known.upper) for name, known in declared.items()})
    of_effects = {k for k, name in enumerate(order) if owner_of(name) in catalogue}
    size = len(train)
    measured = [
        _measured(large, data, part, rows, kept)
        for part, rows in ((train, slice(0, size)), (test, slice(size, None)))
        if part
    ]
    return Problem(
        models=NestedModels(batch, box, neutral),
        names=order,
        units=large.mechanics.units,
        catalogue=catalogue,
        law=np.asarray([k for k in range(len(order)) if k not in of_effects]),
        effects=own,
        scales=large.simulation.scales,
        train=measured[0],
        test=measured[1] if test else None,
        experiments=train,
        outputs=large.observed.outputs,
        candidates=inputs,
        seed=built.study.seed,
        notes=(
            *built.mechanics.naming.left_out(),
            *built.experiments.thinning_notes(campaign.train),
            *_without_time(built, campaign),
        ),
        pair=large.mechanics.pair,
        held_out=test,
        simulator=large.simulation.simulator if isinstance(large.simulation.simulator, Simulator) else None,
        visited=_visited(large, train, campaign),
    )


def _without_time(built: Built, campaign: Campaign) -> list[str]:
    """A note on the meaning of a second in a component test without time."""
    if campaign.has_time or not built.experiments.component_test:
        return []
    return ["the record has no time: in delays and drifts of the test rig, a second stands for a row"]


def _visited(large: Built, experiments: Sequence[Experiment], campaign: Campaign) -> Range | None:
    """The range of the data: the measured elongation with the longest path, or cycles up to the characteristic elongation."""
    if not isinstance(large.simulation.simulator, Simulator):
        return None
    scales, has_time = large.simulation.scales, campaign.has_time or not large.experiments.component_test
    measured = [
        range_of(values, float(scales.rate), has_time)
        for experiment in experiments
        if experiment.record is not None
        for name, values in experiment.record.channels.items()
        if own_name(name) == "elongation"
    ]
    if measured:
        return max(measured, key=lambda visited: visited.path)
    cycles = float(scales.elongation) * np.linspace(0.0, 1.0, _REVERSALS) * (-1.0) ** np.arange(_REVERSALS)
    return Range(cycles, float(scales.rate), has_time)


def _forms(large: Built, effect: str, order: tuple[str, ...], only: str | None) -> dict[str, FormColumns]:
    """The allowed forms of a candidate, in a model with these parameters."""
    kind = large.mechanics.catalogue[effect]
    found: dict[str, FormColumns] = {}
    for label, form in large.mechanics.naming.forms(effect).items():
        columns = np.asarray([order.index(f"{effect}.{p}") for p in form.parameters(kind)])
        held = {order.index(f"{effect}.{p}"): value for p, value in form.held.items()}
        if only is None or label == only:
            found[label] = FormColumns(form, columns, held)
    return found


def _declared(free: Iterable[str], effects: Catalogue) -> dict[str, Parameter]:
    """The parameters of effects, by their names in the model."""
    return {
        name: parameters_of(effects[effect])[own_name(name)] for name in free if (effect := owner_of(name)) in effects
    }


def _neutral(free: Mapping[str, Prior], declared: Mapping[str, Parameter]) -> np.ndarray:
    values: list[float] = []
    for name, prior in free.items():
        if name in declared:
            neutral = declared[name].neutral
            assert neutral is not None
            values.append(neutral)
        else:
            values.append(float(prior.quantile(0.5)))
    return np.asarray(values)


def _kept(large: Built, experiments: Sequence[Experiment]) -> Int[np.ndarray, " K"]:
    """Indices of the outputs that an experiment has: samples after the longest record are only padding of the program."""
    observation = large.inference.observation
    count = len(observation.groups)
    if not isinstance(observation, Histories):
        return np.arange(count)
    longest = max(0 if e.record is None else len(e.record) for e in experiments)
    return np.flatnonzero(np.arange(count) % observation.samples < longest)


def _measured(
    large: Built, data: Data, experiments: Sequence[Experiment], rows: slice, kept: Int[np.ndarray, " K"]
) -> Measured:
    values, used, gaps = (np.asarray(table)[rows][:, kept] for table in (data.values, data.weights, data.gaps))
    groups = np.asarray(large.inference.observation.groups)[kept]
    measured = Measured(values, used > 0, gaps, groups, large.observed.errors, 0.0)
    # Without a declared noise, the noise of a history is estimated from its record; a single quantity gives no estimate.
    declared = ~np.isnan(measured.declared)
    is_history = np.bincount(groups, minlength=len(large.observed.errors)) >= HISTORY
    unknown = np.where(is_history, _ANY_NOISE, 1 / _ANY_NOISE)
    sigma = measured.sigma(np.where(declared, measured.declared, unknown), values)
    itself = Prediction(
        large.observed.outputs,
        groups,
        tuple(experiments),
        values,
        used > 0,
        values,
        values,
        sigma,
        sigma,
        np.ones(len(values), bool),
    )
    return measured._replace(noise=compare(itself, None, declared, 0, []).train.noise_floor)


def _candidates(
    built: Built, campaign: Campaign, cube: np.ndarray | None
) -> tuple[list[dict[str, float]], Conditions | None]:
    """Inputs of candidate experiments, in declared units, and their conditions; none if the inputs give no excitation."""
    space = built.experiments.space
    excitation = built.experiments.excitation
    if (
        excitation is None
        or not space.names
        or cast(type[AbstractExcitation], excitation.constructor).declared.kind.protocol != built.experiments.protocol
    ):
        return [], None
    if not built.experiments.component_test and drivers(built, campaign) != [driver_of(built.study)]:
        return [], None
    declared = space.declared(space.initial_design(_CANDIDATES) if cube is None else cube)
    si = space.si(declared)
    longest = max(campaign.train.experiments, key=lambda e: 0 if e.record is None else len(e.record))
    conditions: list[Conditions] = []
    for number in range(len(declared)):
        inputs = dict(longest.inputs) | {name: float(values[number]) for name, values in si.items()}
        record = None if longest.record is None else Record(_times(excitation(inputs), longest.record.time), {})
        experiment = Experiment(f"candidate {number + 1}", inputs, record=record)
        conditions.append(conditions_of(experiment, campaign, built.simulation.grid, excitation))
    return [dict(zip(space.names, row.tolist(), strict=True)) for row in declared], stacked(conditions)


def _times(excitation: AbstractExcitation, recorded: np.ndarray) -> np.ndarray:
    """Sample times of a candidate experiment: those of its own imposed elongation, or else those of the records."""
    own = Timeline(None, len(recorded) - 1)
    if excitation.declared.kind.protocol == "displacement":
        return np.asarray(times(excitation.step_length(own), 1, own.samples))
    return recorded


def _padded(conditions: Conditions) -> Conditions:
    size = jax.tree.leaves(conditions)[0].shape[0]
    more = -size % _PADDING

    def padded(leaf: Array) -> Array:
        return jnp.concatenate([leaf, jnp.repeat(leaf[-1:], more, axis=0)])

    return jax.tree.map(padded, conditions)
