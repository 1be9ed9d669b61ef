"""Whether the steps of a study make a plan: their order, and what each needs."""

import difflib
from collections.abc import Sequence
from itertools import pairwise

from hsed_jax.config.schema import ModelEntry, Study
from hsed_jax.errors import UserError
from hsed_jax.physics.effects import Catalogue

ORDER = ["design", "calibrate", "compare", "diagnose", "improve"]


def check_plan(study: Study, catalogue: Catalogue) -> None:
    """Refuse steps that cannot be done one after the other, and a design that cannot be made.

    Raises:
        UserError: names the key and what is allowed.
    """
    steps = study.steps
    for before, step in pairwise(steps):
        if ORDER.index(before) >= ORDER.index(step):
            raise UserError(f"steps: {before} stands before {step}; the order is {', '.join(ORDER)}")
    if "compare" in steps and "calibrate" not in steps:
        raise UserError("steps: compare needs a calibrated model; put calibrate before it")
    if {"diagnose", "improve"} & set(steps) and "compare" not in steps:
        raise UserError("steps: diagnose and improve need the comparison; put calibrate, compare before them")
    if "improve" in steps and "diagnose" not in steps and study.improve.add is None:
        raise UserError("steps: improve needs diagnose before it, or improve.add with the effects to add")
    if study.experiments.folder is not None and "design" not in steps:
        raise UserError("steps: experiments.folder is asked by the step design; put design first")
    check_added(study.model, study.improve.add or [], catalogue, "improve.add: ")
    if study.experiments.laboratory is not None or "design" in steps:
        _check_design(study)


def check_added(model: ModelEntry, effects: Sequence[str], catalogue: Catalogue, where: str = "") -> None:
    """Refuse effects that cannot be added to a model.

    Raises:
        UserError: one is unknown, there already, or given twice.
    """
    for name in effects:
        if name not in catalogue:
            close = difflib.get_close_matches(name, catalogue, n=1)
            hint = f" (did you mean {close[0]}?)" if close else ""
            raise UserError(
                f"{where}there is no effect {name!r}{hint}; the catalogue has {', '.join(sorted(catalogue))}"
            )
        if name in model.effects:
            raise UserError(f"{where}the model has {name} already")
        if list(effects).count(name) > 1:
            raise UserError(f"{where}{name} is to be added twice")


def _check_design(study: Study) -> None:
    if not study.inputs:
        raise UserError("inputs: a design needs at least one input, such as V_P: {uniform: [1.5, 3.0], unit: m/s}")
    entry, d = study.design, len(study.inputs)
    needed = {"constant": 1, "linear": 1 + d, "quadratic": (d + 1) * (d + 2) // 2}[entry.kriging.trend] + 1
    if "design" in study.steps and entry.initial < needed:
        raise UserError(
            f"design.initial: a {entry.kriging.trend} trend in {d} inputs needs at least {needed} experiments, "
            f"but it is {entry.initial}"
        )
    if entry.candidates < entry.initial + entry.iterations:
        raise UserError(
            f"design.candidates: {entry.candidates} are too few to choose {entry.iterations} experiments from"
        )
