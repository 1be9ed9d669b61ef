"""Formulas fitted inside the simulation: each as the effect of its file; the evidence of the data chooses one."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.fit_state import FitState, Target, Task
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.discovery.effect_file import source_of
from hsed_jax.discovery.formulas import Formula
from hsed_jax.discovery.places import Place
from hsed_jax.discovery.search import HeldOutError, flat, held_out_error
from hsed_jax.drafts import write_whole
from hsed_jax.physics.effects import AbstractEffect, registered
from hsed_jax.python_files import executed


class FittedFormula(NamedTuple):
    """A formula fitted inside the simulation.

    Attributes:
        formula: with the numbers of its fit.
        log_evidence: of the model with it.
        models, fit: the fit, and the models it is one of.
    """

    formula: Formula
    log_evidence: float
    models: NestedModels
    fit: FitState


class FormulaFits:
    """Formulas fitted side by side.

    Arguments:
        tried: the formulas.
        reaches: of their coordinates.
        problem_of: makes the problem with these effects as candidates.
        target: the fitted data.
        law: parameters of the first model, by name, SI.
    """

    def __init__(
        self,
        tried: Sequence[Formula],
        reaches: Sequence[tuple[float, float]],
        problem_of: Callable[..., Problem],
        target: Target,
        law: Mapping[str, float],
    ):
        kinds = _effects(tried, reaches)
        self.problem = problem_of(*kinds)
        self._target, self._law = target, law
        self._models = self.problem.models.within(flat(self.problem, {}))
        names = [kind.name for kind in kinds]
        tasks = [self._task(name, formula) for name, formula in zip(names, tried, strict=True)]
        fits = zip(names, tried, self._models.fit(target, tasks), strict=True)
        self._fitted = [
            FittedFormula(self._refined(name, formula, fit), laplace(fit, self._models), self._models, fit)
            for name, formula, fit in fits
            if np.isfinite(fit.cost)
        ]

    @property
    def best(self) -> FittedFormula | None:
        """The formula with the largest evidence; None if no formula could be simulated."""
        return max(self._fitted, key=lambda one: one.log_evidence, default=None)

    def held_out_error(self, one: FittedFormula) -> HeldOutError:
        """The predictions of held-out data by the model with a formula."""
        plain = Task(self._models.submodel(self.problem.law), self._models.point(self._law))
        base = self._models.fit(self._target, [plain])[0]
        return held_out_error(self.problem, self._target, (one.models, one.fit), (self._models, base))

    def _task(self, name: str, formula: Formula) -> Task:
        known = {
            f"{name}.a": formula.size,
            **self._law,
            **dict(zip(_numbers(name, formula), _values(formula), strict=True)),
        }
        if f"{name}.fade" in self.problem.names:
            known[f"{name}.fade"] = formula.place.fade
        columns = self.problem.effects[name][""].columns
        free = np.concatenate([self.problem.law, columns]).astype(int)
        return Task(self._models.submodel(free), self._models.point(known))

    def _refined(self, name: str, formula: Formula, fit: FitState) -> Formula:
        """A formula with the numbers of its fit."""
        theta = dict(zip(self.problem.names, map(float, self._models.theta(fit.x, fit.submodel)), strict=True))
        left = [theta[key] for key in _numbers(name, formula)]
        terms = []
        for term in formula.terms:
            own, left = left[: len(term.numbers)], left[len(term.numbers) :]
            terms.append(term._replace(numbers=tuple(own)))
        place = Place(formula.place.slot, formula.place.of, theta.get(f"{name}.fade", formula.place.fade))
        return replace(formula, place=place, terms=tuple(terms), size=theta[f"{name}.a"])


def _numbers(name: str, formula: Formula) -> list[str]:
    """Parameters of the effect of a formula, besides its size."""
    return [f"{name}.{number.symbol}_{n}" for n, term in enumerate(formula.terms, 1) for number in term.shape.numbers]


def _values(formula: Formula) -> list[float]:
    return [value for term in formula.terms for value in term.numbers]


def _effects(tried: Sequence[Formula], reaches: Sequence[tuple[float, float]]) -> list[type[AbstractEffect]]:
    """Formulas as the effects of their files."""
    with tempfile.TemporaryDirectory() as folder:
        found = []
        for number, formula in enumerate(tried):
            path = Path(folder) / f"formula_{number}.py"
            write_whole(path, source_of(formula, reaches, path.stem))
            found += registered(executed(path))
        return found
