"""Checks of the steps of a study: their order, and the requirements of each."""

import difflib
from collections.abc import Sequence
from itertools import pairwise

from hsed_jax.config.schema import CalibrationEntry, Study
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.design.cost import Cost
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.memory import check_memory
from hsed_jax.study.specimens import Naming, effects_of

# An experiment as an object, with its inputs and quantities [bytes].
_EXPERIMENT = 1000
ORDER = ["design", "calibrate", "compare", "diagnose", "discover", "improve"]


def check_plan(study: Study, space: InputSpace) -> None:
    """Refuse a wrong order of steps, and an impossible design.

    Arguments:
        study: the study.
        space: of its inputs.

    Raises:
        UserError: with the key and the allowed values.
    """
    steps = study.steps
    for before, step in pairwise(steps):
        if ORDER.index(before) >= ORDER.index(step):
            raise UserError(f"steps: {before} stands before {step}; the order is {', '.join(ORDER)}")
    if "compare" in steps and "calibrate" not in steps:
        raise UserError("steps: compare needs a calibrated model; put calibrate before it")
    if {"diagnose", "improve"} & set(steps) and "compare" not in steps:
        raise UserError("steps: diagnose and improve need the comparison; put calibrate, compare before them")
    if "discover" in steps and "diagnose" not in steps:
        raise UserError("steps: discover needs a diagnosis; put diagnose before it")
    if "discover" in steps and study.structure is not None and study.structure.specimens is not None:
        raise UserError("steps: discover works with one specimen, but this study has named specimens; leave it out")
    if "improve" in steps and "diagnose" not in steps and study.improve.add is None:
        raise UserError("steps: improve needs diagnose before it, or improve.add with the effects to add")
    if study.model.levels and "design" in steps:
        raise UserError(
            "model.levels: a design plans experiments of one specimen; leave the levels out, or the step design"
        )
    laboratory = study.experiments.laboratory
    if laboratory is not None and laboratory.is_asked and "design" not in steps:
        raise UserError(f"steps: experiments.{study.experiments.kind} is asked by the step design; put design first")
    _check_sizes(study)
    if laboratory is not None or "design" in steps:
        _check_design(study)
    if study.design.cost is not None:
        if ACQUISITIONS[study.design.acquisition].is_order:
            raise UserError(
                f"design.cost: a cost does not change the order of the experiments of {study.design.acquisition}; leave it "
                "out, or choose another acquisition"
            )
        Cost(study.design.cost.fixed, study.design.cost.per, space)


def _check_sizes(study: Study) -> None:
    """Refuse sizes that exceed the RAM, from the arrays and objects that each certainly needs."""
    design, sizes, usual = study.design, study.calibration, CalibrationEntry()
    given = [entry for model in study.models.values() for entry in model.parameters.values()]
    free = [entry for entry in given if not isinstance(entry, float)]
    laboratory = study.experiments.laboratory
    test = 0 if laboratory is None else laboratory.further
    asked = design.iterations if "design" in study.steps else 0
    experiments = design.initial + asked + test if laboratory is not None else 1
    # The Kriging of a design has a covariance between all experiments, and one between them and every candidate.
    related = experiments if "design" in study.steps else 1
    for key, count, each in (
        ("design.initial", design.initial, _EXPERIMENT + 8 * related),
        ("design.iterations", asked, _EXPERIMENT + 8 * related),
        (f"experiments.{study.experiments.kind}.test", test, _EXPERIMENT),
        ("design.candidates", design.candidates, 8 * related),
        ("design.kriging.starts", design.kriging.starts, 8 * related**2),
        ("calibration.starts", sizes.starts, 8 * experiments * (1 + len(free))),
        # If the number is usual, the length of a chain is too large.
        ("calibration.chains", sizes.chains, 8 * max(min(sizes.draws, usual.draws), experiments) * (1 + len(free))),
        ("calibration.draws", sizes.draws, 8 * sizes.chains * (1 + len(free))),
        ("calibration.step_draws", sizes.step_draws, 8 * sizes.chains * (1 + len(free))),
        ("calibration.warmup", sizes.warmup, 8 * sizes.chains * (1 + len(free))),
        ("calibration.step_warmup", sizes.step_warmup, 8 * sizes.chains * (1 + len(free))),
    ):
        check_memory(f"{key}: {count}", count * each, each)


def check_added(study: Study, effects: Sequence[str], naming: Naming, where: str = "") -> None:
    """Refuse effects that cannot be added to a model.

    Raises:
        UserError: one is unknown, already in the model, given twice, or impossible with the law.
    """
    for name in effects:
        if name not in naming.catalogue:
            close = difflib.get_close_matches(name, naming.catalogue, n=1)
            hint = f" (did you mean {close[0]}?)" if close else ""
            raise UserError(
                f"{where}there is no effect {name!r}{hint}; the catalogue has {', '.join(sorted(naming.catalogue))}"
            )
        if name in effects_of(study):
            raise UserError(f"{where}the model has {name} already")
        if missing := naming.unserved(name):
            raise UserError(f"{where}{name} cannot be added: {missing}")
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
