"""What a diagnosis works on: the measurements, and the model with every candidate effect in it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from hsed_jax.behaviour.histories import Range
from hsed_jax.diagnosis.measured import Measured
from hsed_jax.diagnosis.nested import NestedModels
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
        held: what it holds other parameters at, by index.
    """

    form: Form
    columns: Int[np.ndarray, " q"]
    held: Mapping[int, float]


Forms = Mapping[str, FormColumns]
"""The forms of a candidate by their labels, the default one first."""


def amplitude_of(forms: Forms) -> tuple[int, Mapping[int, float]]:
    """The amplitude of an effect in its default form, and what that holds."""
    form = next(iter(forms.values()))
    return int(form.columns[0]), form.held


def of_simplest_shape(forms: Forms) -> list[str]:
    """The forms of the default one's shape, with whatever driver that has no parameters of its own."""
    default = next(iter(forms.values()))
    return [
        label
        for label, form in forms.items()
        if form.form.name == default.form.name and len(form.columns) == len(default.columns)
    ]


def of_other_drivers(forms: Forms, label: str) -> list[str]:
    """The forms with whatever driver: of the same shape, and of the simplest one, whose fit misses no driver for its shape."""
    simplest = min(forms.values(), key=lambda form: len(form.columns)).form.name
    return [other for other, form in forms.items() if form.form.name in (forms[label].form.name, simplest)]


def of_other_shapes(forms: Forms, label: str) -> list[str]:
    """The forms with the same driver, of whatever shape."""
    return [other for other, form in forms.items() if form.form.driver == forms[label].form.driver]


class Problem(NamedTuple):
    """What a diagnosis works on.

    Attributes:
        models: the model with every candidate effect in it.
        names, units: of its parameters.
        catalogue: the candidates.
        law: indices of the parameters that are free without any candidate.
        effects: the forms of each candidate.
        scales: characteristic values.
        train, test: measured experiments; the first rows of the conditions of a batch, in this order.
        experiments: the training experiments.
        outputs: names of the outputs.
        candidates: inputs of experiments that could be made, in declared units; the rows after those measured.
        pending: how many of these, the last ones, are being performed, and will be known before another one is.
        seed: of random numbers.
        start: the model as it is, as a calibration left it, (P,); None where there was none.
        notes: what a reader should know of the candidates, in sentences.
        pair: that the specimen is measured in.
        held_out: the experiments of `test`.
        opened: parameters of the law whose priors are open here, since the calibration leans on their bounds.
        simulator: the model as one of springs, with every candidate in it; None where it is none.
        visited: what the specimens went through; None where there is no such model.
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
    simulator: Simulator | None = None
    visited: Range | None = None

    @property
    def rows(self) -> int:
        """How many experiments were measured."""
        return len(self.train.values) + (0 if self.test is None else len(self.test.values))

    def of_few(self, most: int) -> "Problem | None":
        """The problem with so many training experiments of histories, evenly chosen; None where there are no more."""
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
        """Errors of experiments that were not made, from predictions: relative ones need a magnitude."""
        return errors[self.train.groups] * self.train.expected_scales(predicted, np.ones(predicted.shape))
