"""The frozen baseline: its results are what they were, within what each of them may change."""

import baseline
import pytest
from baseline import Frozen, compared, frozen


def allowed(kept, now):
    return {row[0]: row[-1] for row in compared(kept, now)}


@pytest.mark.whole
def test_calibration_diagnosis_and_design_have_the_frozen_results():
    rows = compared(frozen(), dict(baseline.results()))
    assert [row for row in rows if not row[-1]] == []


def test_every_frozen_result_says_how_far_it_may_change_and_why():
    kept = frozen()
    assert {name.split(":")[0] for name in kept} == {"calibration", "diagnosis", "design"}
    for one in kept.values():
        assert one.why and (isinstance(one.value, str) if one.allowed is None else 0 < one.allowed <= 0.05)


def test_a_change_beyond_what_is_allowed_is_told():
    kept = {"a": Frozen(2.0, 0.01, "why"), "b": Frozen("adequate", None, "why"), "c": Frozen(1.0, 0.1, "why")}
    same = kept | {"a": Frozen(2.019, 0.5, "why")}
    assert allowed(kept, same) == {"a": True, "b": True, "c": True}
    other = {"a": Frozen(2.021, 0.5, "why"), "b": Frozen("ambiguous", None, "why"), "d": Frozen(1.0, 0.1, "why")}
    assert allowed(kept, other) == {"a": False, "b": False, "c": False, "d": False}
    assert allowed(kept, kept | {"a": Frozen(float("nan"), 0.01, "why")})["a"] is False
