"""The problem of a diagnosis: the measurements, and the model with every candidate effect."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from hsed_jax.behaviour.histories import Range
from hsed_jax.diagnosis.batch import Apart, BatchApart
from hsed_jax.diagnosis.box import Box
from hsed_jax.diagnosis.measured import Measured
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.inference.leaning import opened as without_bounds
from hsed_jax.inference.watch import Watch
from hsed_jax.measurements import Experiment
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.effects.base import Form
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE, Pair
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Simulator


class FormColumns(NamedTuple):
    """A form of a candidate in the large model.

    Attributes:
        form: the form.
        columns: indices of its free parameters, the amplitude first, (q,).
        held: values of the other parameters that the form fixes, by index.
    """

    form: Form
    columns: Int[np.ndarray, " q"]
    held: Mapping[int, float]


Forms = Mapping[str, FormColumns]
"""The forms of a candidate by their labels, the default one first."""


def amplitude_of(forms: Forms) -> tuple[int, Mapping[int, float]]:
    """Index of the amplitude of an effect in its default form, and the values that this form fixes."""
    form = next(iter(forms.values()))
    return int(form.columns[0]), form.held


def of_fewest_parameters(forms: Forms) -> list[str]:
    """The forms with no more parameters than the default one: with the default driver, or in the shape of the default form."""
    default = next(iter(forms.values()))
    return [
        label
        for label, form in forms.items()
        if len(form.columns) <= len(default.columns)
        and (form.form.name == default.form.name or form.form.driver == default.form.driver)
    ]


def of_other_drivers(forms: Forms, label: str) -> list[str]:
    """The forms with any driver, in the same shape and in the simplest one, so that no driver fails because of its shape."""
    simplest = min(forms.values(), key=lambda form: len(form.columns)).form.name
    return [other for other, form in forms.items() if form.form.name in (forms[label].form.name, simplest)]


def of_other_shapes(forms: Forms, label: str) -> list[str]:
    """The forms with the same driver and any shape."""
    return [other for other, form in forms.items() if form.form.driver == forms[label].form.driver]


class Problem(NamedTuple):
    """The problem of a diagnosis.

    Attributes:
        models: the model with every candidate effect.
        names, units: of its parameters.
        catalogue: the candidates.
        law: indices of the parameters that are free in every model.
        effects: the forms of each candidate.
        scales: characteristic values.
        train, test: measured experiments; their rows are the first ones of the conditions of a batch, in this order.
        experiments: the training experiments.
        outputs: names of the outputs.
        candidates: inputs of candidate experiments, in declared units; their rows follow those of the measured ones.
        pending: number of candidates, the last ones, that are being performed; their results precede any other experiment.
        seed: of random numbers.
        start: x of the first model (without candidates) from a calibration, (P,); None without a calibration.
        notes: sentences on the candidates for the reader.
        pair: the pair of quantities in which the specimen is measured.
        held_out: the experiments of `test`.
        opened: parameters of the law whose prior bounds are removed, because their calibrated values are on these bounds.
        excludes: whether these bounds exclude what the data show: the noise does not explain the residual with them.
        simulator: the spring model with every candidate; None for a model of another kind.
        visited: the range of the data; None for a model of another kind.
    """

    models: NestedModels
    names: tuple[str, ...]
    units: Mapping[str, str]
    catalogue: Catalogue
    law: np.ndarray
    effects: Mapping[str, Forms]
    scales: Scales
    train: Measured
    test: Measured | None
    experiments: tuple[Experiment, ...]
    outputs: tuple[str, ...]
    candidates: Sequence[dict[str, float]]
    seed: int
    pending: int = 0
    start: np.ndarray | None = None
    notes: Sequence[str] = ()
    pair: Pair = ELONGATION_AND_FORCE
    held_out: tuple[Experiment, ...] = ()
    opened: tuple[str, ...] = ()
    excludes: bool = False
    simulator: Simulator | None = None
    visited: Range | None = None

    @property
    def rows(self) -> int:
        """The number of measured experiments."""
        return len(self.train.values) + (0 if self.test is None else len(self.test.values))

    def calibrated(
        self,
        known: Mapping[str, float],
        apart: Apart | None = None,
        opened: Sequence[str] = (),
        excludes: bool = True,
        watch: Watch | None = None,
    ) -> "Problem":
        """The same problem after a calibration of the first model (without candidates).

        Arguments:
            known: its parameters, by name, SI.
            apart: differences of the specimens from their population, training experiments first; they are constant.
            opened: parameters whose estimates are on a bound of their prior that is not a physical limit.  The bound is removed
                here, so that no effect is named because of it.
            excludes: whether the noise does not explain the residual of the calibrated model, with these bounds.
            watch: follows the fits.
        """
        priors, batch = self.models.box.priors, self.models.batch
        box = Box(priors | {name: without_bounds(priors[name]) for name in opened}, limits=self.models.box.limits)
        if apart is not None:
            batch = BatchApart(batch, apart.across(self.names, self.rows + len(self.candidates)))
        models = self.models.within(box, batch, watch)
        found = self._replace(models=models, opened=tuple(opened), excludes=bool(opened) and excludes)
        return found._replace(start=found.point(known))

    def point(self, known: Mapping[str, float]) -> Float[np.ndarray, " P"]:
        """The point x of known parameters, by name, SI; names that the problem does not have are left out."""
        return self.models.point({name: value for name, value in known.items() if name in self.names})

    def of_few(self, most: int) -> "Problem | None":
        """The problem with `most` training experiments, evenly chosen; None if it has no more, or if an output is no history."""
        count = len(self.train.values)
        is_history = np.bincount(self.train.groups).min() > 1
        if count <= most or not is_history:
            return None
        rows = np.unique(np.round(np.linspace(0, count - 1, most)).astype(int))
        others = np.arange(count, self.rows + len(self.candidates))
        train = self.train
        return self._replace(
            models=self.models.of_experiments(np.append(rows, others)),
            train=train._replace(values=train.values[rows], used=train.used[rows], gaps=train.gaps[rows]),
            experiments=tuple(self.experiments[int(row)] for row in rows),
        )

    def sigma(self, errors: Float[np.ndarray, " G"], predicted: Float[np.ndarray, "r J"]) -> Float[np.ndarray, "r J"]:
        """Errors of experiments that are not made, from predictions: a relative error needs a magnitude."""
        return errors[self.train.groups] * self.train.expected_scales(predicted, np.ones(predicted.shape))
