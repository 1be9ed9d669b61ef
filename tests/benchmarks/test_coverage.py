"""Intervals cover, p-values keep their promise, nothing is found where nothing is hidden: `benchmarks/intervals.py`, in small."""

import importlib.util
import sys

import numpy as np
import pytest
from builders.places import ROOT

PROGRAM = ROOT / "benchmarks" / "intervals.py"
CAMPAIGNS = 100


@pytest.fixture(scope="module")
def coverage():
    spec = importlib.util.spec_from_file_location("coverage_benchmark", PROGRAM)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_90_percent_intervals_cover_85_to_95_percent(coverage):
    found = [coverage.intervals(case, range(CAMPAIGNS)) for case in coverage.INTERVALS]
    shares = np.asarray([[np.mean(held) for held in case.values()] for case in found])
    # Each within two standard errors of the range, all together within it.
    error = 2 * np.sqrt(0.9 * 0.1 / CAMPAIGNS)
    assert shares.min() > 0.85 - error and shares.max() <= 0.95 + error, shares
    assert 0.85 < shares.mean() < 0.95, shares


@pytest.mark.slow
def test_a_right_model_has_a_p_value_below_a_hundredth_in_at_most_two_of_a_hundred(coverage):
    found = [coverage.p_values(case, range(CAMPAIGNS))["p"] for case in coverage.TRUE_MODEL]
    assert np.mean(np.asarray(found) < 0.01) <= 0.02
    # Neither does it keep its promise by being large always.
    assert np.mean(np.asarray(found) < 0.5) > 0.3


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_hidden(coverage):
    for case in coverage.TRUE_MODEL:
        assert coverage.diagnoses(case, range(5))["verdict"] == ["adequate"] * 5, case


@pytest.mark.slow
def test_the_larger_an_effect_the_more_often_it_is_seen(coverage):
    weakest, *_, strongest = coverage.POWER
    seen = [
        ["stiffness_degradation" in named for named in coverage.diagnoses(case, range(5))["effects"]]
        for case in (weakest, strongest)
    ]
    assert np.mean(seen[0]) < np.mean(seen[1])
    assert all(seen[1])
