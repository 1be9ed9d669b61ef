"""What other methods make of the same rows: two laws fitted by differential evolution and two black boxes.

Each method gets the tests of one question (`records.py`) and returns the force of every row. Its error is the RMS of the residual
over the RMS of the measured force, once of the rows it fitted and once of the rows it did not. Seconds are CPU seconds, with the
compilation of programs that this machine has not compiled before.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from board import black_boxes, hysteresis
from board.records import QUESTIONS, Specimen, Test, error, tests_of

import hsed_jax as hx

METHODS: Mapping[str, Callable[[Sequence[Test]], list[np.ndarray]]] = {
    "plain law": lambda tests: hysteresis.fitted(tests, hysteresis.PLAIN),
    "Bouc-Wen-Baber-Noori": lambda tests: hysteresis.fitted(tests, {}),
    "Gaussian process": black_boxes.gaussian_process,
    "recurrent network": black_boxes.network,
}
"""The names are those of the tables."""


def compared(specimen: Specimen, known: Mapping[str, Any]) -> dict[str, Any]:
    """The errors of every method under every question.

    Arguments:
        specimen: the record.
        known: what is there already, by question and method; it is not computed again.

    Returns:
        By question and method: `fitted` and `held` errors [1] and CPU `seconds`; of a question that the record does not allow,
        its `reason` in words.

    Raises:
        UserError: the record cannot be used at all.
    """
    campaign = specimen.campaign()
    found: dict[str, Any] = {}
    for question in QUESTIONS:
        rows = dict(known.get(question, {}))
        missing = [name for name in METHODS if name not in rows and "reason" not in rows]
        try:
            tests = tests_of(campaign, question) if missing else []
        except hx.UserError as refusal:
            found[question] = {"reason": str(refusal)}
            continue
        for name in missing:
            rows[name] = _measured(METHODS[name], tests)
        found[question] = rows
    return found


def _measured(method: Callable[[Sequence[Test]], list[np.ndarray]], tests: Sequence[Test]) -> dict[str, float]:
    begin = time.process_time()
    forces = method(tests)
    seconds = time.process_time() - begin
    errors = {which: float(f"{error(tests, forces, which):.4g}") for which in ("fitted", "held")}
    if not np.isfinite(list(errors.values())).all():
        raise FloatingPointError("a comparison returned a force that is not finite")
    return {**errors, "seconds": round(seconds, 1)}
