"""Rows of the verification manual: a test compares a number with its reference, and the row has the error and its tolerance.

A test with the mark `verification` says its chapter there and asks for the fixture `observed`.  `docs/verification.py` runs these
tests and writes the pages.  Every other run compares the rows of a test with those that the manual has of it: their words and
their tolerances, but not their errors, which differ between machines.
"""

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
from builders.places import ROOT

KEPT = ROOT / "docs" / "verification" / "observed.json"
PROPERTY = "observed"
# What a row says besides its error, which may differ.
WORDS = ("chapter", "problem", "reference", "tolerance")


def of_largest(found: Any, expected: Any) -> float:
    """Largest difference over the largest expected value."""
    found, expected = np.asarray(found), np.asarray(expected)
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


def relative(found: Any, expected: Any) -> float:
    """Largest relative difference."""
    found, expected = np.asarray(found), np.asarray(expected)
    return float(np.max(np.abs(found - expected) / np.abs(expected)))


class Observed:
    """Compares errors with their tolerances, and keeps a row of each.

    Arguments:
        node: the test.
    """

    def __init__(self, node: pytest.Item) -> None:
        marker = node.get_closest_marker("verification")
        if marker is None:
            raise pytest.UsageError(f"{node.nodeid}: the fixture `observed` needs @pytest.mark.verification(CHAPTER)")
        self.node, self.chapter = node, marker.args[0]
        self.rows: list[dict[str, Any]] = []

    def __call__(self, problem: str, reference: str, error: Any, tolerance: float, **figures: float) -> None:
        """Compare an error with its tolerance, and keep the row.

        Arguments:
            problem: what is computed; equal problems of one test share a row of the page, which has the largest error.
            reference: what it is compared with.
            error: one number or several, of which the one of the largest size counts.
            tolerance: the largest error that is allowed.
            figures: further numbers of the row.

        Raises:
            AssertionError: the error is larger than the tolerance, or no number.
        """
        largest = float(np.max(np.abs(np.asarray(error, dtype=float))))
        self.rows.append(
            {
                **{"chapter": self.chapter, "problem": problem, "reference": reference, "tolerance": float(tolerance)},
                "error": largest,
                **({"figures": {name: float(value) for name, value in figures.items()}} if figures else {}),
            }
        )
        assert largest <= tolerance, f"{problem} against {reference}: the error {largest:.3g} is above {tolerance:.3g}"

    def finish(self, is_measuring: bool) -> None:
        """Hand the rows over to the report of the test, or compare them with those that the manual has of it."""
        if is_measuring:
            self.node.user_properties.append((PROPERTY, self.rows))
        elif words(self.rows) != words(kept().get(self.node.nodeid, self.rows)):
            pytest.fail(f"{self.node.nodeid} has other rows than the manual: run `python docs/verification.py`", False)


def words(rows: list[dict[str, Any]]) -> list[tuple[Any, ...]]:
    """What rows say besides their errors."""
    return [tuple(row[key] for key in WORDS) for row in rows]


@cache
def kept() -> dict[str, list[dict[str, Any]]]:
    """The rows that the manual has, by test."""
    return json.loads(KEPT.read_text(encoding="utf-8"))["tests"] if KEPT.is_file() else {}
