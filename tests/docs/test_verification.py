"""The verification manual: its pages are what was measured, its tests exist, and an error above its tolerance fails."""

import ast
import json
import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from builders.places import ROOT
from observations import KEPT, Observed, of_largest, relative, words

from hsed_jax.models.opensees import MATERIALS
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.laws import LAWS

FOLDER = ROOT / "docs" / "verification"


@pytest.fixture
def manual(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    import verification

    return verification


@pytest.fixture(scope="module")
def kept() -> dict:
    return json.loads(KEPT.read_text(encoding="utf-8"))


@cache
def functions(file: str) -> dict[str, list[str]]:
    """Tests of a file, each with its decorators; the file from the folder of tests on."""
    tree = ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8"))
    found = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"))
    return {node.name: [ast.unparse(one) for one in node.decorator_list] for node in found}


def marked() -> dict[str, str]:
    """Every test with a chapter, by its identifier."""
    found = {}
    for path in (ROOT / "tests").rglob("test_*.py"):
        file = path.relative_to(ROOT / "tests").as_posix()
        for name, decorators in functions(file).items():
            for one in decorators:
                if chapter := re.search(r"mark\.verification\(['\"](\w+)['\"]\)", one):
                    found[f"tests/{file}::{name}"] = chapter[1]
    return found


def test_the_pages_are_what_was_measured(manual, kept):
    for name, text in manual.pages(kept).items():
        assert (FOLDER / name).read_text(encoding="utf-8") == text, "run `python docs/verification.py --pages`"


def test_every_test_that_is_named_exists():
    for page in FOLDER.glob("*.md"):
        for file, name in re.findall(r"`((?:\w+/)?test_\w+\.py)::(\w+)", page.read_text(encoding="utf-8")):
            assert name in functions(file), f"{page.name}: {file}::{name}"


@pytest.mark.whole
def test_every_test_with_a_chapter_has_its_rows_or_a_reason(manual, kept):
    of_tests = {node.split("[")[0] for node in (*kept["tests"], *kept["skipped"])}
    assert of_tests == set(marked())
    assert set(marked().values()) == set(manual.CHAPTERS)
    for node, rows in kept["tests"].items():
        assert {row["chapter"] for row in rows} <= {marked()[node.split("[")[0]]}


def test_every_kept_error_is_within_its_tolerance(kept):
    for node, rows in kept["tests"].items():
        assert all(row["error"] <= 1.05 * row["tolerance"] for row in rows), node


def test_every_law_and_every_effect_has_rows(manual, kept):
    problems = {chapter: " ".join(row.problem for row in manual.rows_of(kept, chapter)) for chapter in manual.CHAPTERS}
    assert [law for law in LAWS if f"{law}:" not in problems["convergence"]] == []
    assert [law for law in LAWS if not re.search(rf"\b{law}\b", problems["laws"])] == []
    for chapter in ("laws", "opensees"):
        assert [name for name in MATERIALS if not re.search(rf"\b{name}\b", problems[chapter])] == []
    assert [effect for effect in EFFECTS if not re.search(rf"\b{effect}\b", problems["effects"])] == []


def test_requirements_have_identifiers_of_their_own_and_tests():
    text = (FOLDER / "requirements.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w+) \| (.+?) \| (.+) \|$", text, re.MULTILINE)
    rows = [row for row in rows if row[0] != "id"]
    identifiers = [row[0] for row in rows]
    assert len(identifiers) > 50 and len(set(identifiers)) == len(identifiers)
    name = r"`(\w+/)?test_\w+\.py::test_\w+`"
    for identifier, promise, tests in rows:
        assert re.fullmatch(r"[A-Z]\d\d", identifier) and promise.endswith("."), identifier
        assert re.fullmatch(rf"{name}(, {name})*", tests), identifier


def row(problem="p", error=1.0, tolerance=2.0, **more):
    return {"chapter": "laws", "problem": problem, "reference": "r", "tolerance": tolerance, "error": error, **more}


def test_cases_of_a_test_share_a_row_that_has_the_largest_error(manual):
    tests = {
        "tests/test_a.py::test_x[1]": [row(error=1.0, figures={"order": 3.0}), row("q")],
        "tests/test_a.py::test_x[2]": [row(error=1.5, figures={"order": 4.0})],
        "tests/test_a.py::test_y": [row(error=0.1)],
    }
    found = {(r.test, r.problem): r for r in manual.rows_of({"tests": tests}, "laws")}
    shared = found["tests/test_a.py::test_x", "p"]
    assert (shared.error, shared.cases, shared.figures, shared.share) == (1.5, 2, {"order": 4.0}, 0.75)
    assert len(found) == 3 and manual.rows_of({"tests": tests}, "effects") == []


@pytest.fixture
def node():
    """A test with a chapter."""
    marker = SimpleNamespace(args=("laws",))
    return SimpleNamespace(nodeid="tests/test_a.py::test_x", user_properties=[], get_closest_marker=lambda name: marker)


@pytest.mark.parametrize("error", [2.1, -2.1, np.nan, [0.1, 3.0]], ids=str)
def test_an_error_above_its_tolerance_or_none_fails(node, error):
    with pytest.raises(AssertionError, match=r"p against r: the error .* is above 2"):
        Observed(node)("p", "r", error, 2.0)


def test_what_is_observed_is_handed_over_where_it_is_measured_and_compared_elsewhere(node, monkeypatch):
    rows = Observed(node)
    rows("p", "r", [-1.0, 0.5], 2.0, order=3.0)
    rows.finish(is_measuring=True)
    assert node.user_properties == [("observed", [row(error=1.0, figures={"order": 3.0})])]
    rows.finish(is_measuring=False)  # the manual has no such test
    monkeypatch.setattr("observations.kept", lambda: {node.nodeid: [row(tolerance=3.0)]})
    with pytest.raises(
        pytest.fail.Exception, match=r"has other rows than the manual: run `python docs/verification\.py`"
    ):
        rows.finish(is_measuring=False)
    assert words([row(error=5.0)]) == words([row()]) != words([row(tolerance=3.0)])


def test_a_row_without_a_chapter_is_refused():
    node = SimpleNamespace(nodeid="tests/test_a.py::test_x", get_closest_marker=lambda name: None)
    with pytest.raises(pytest.UsageError, match=r"test_x: the fixture `observed` needs @pytest.mark.verification"):
        Observed(node)


def test_errors_are_those_of_their_names():
    assert of_largest([1.0, 2.2], [1.1, 2.0]) == pytest.approx(0.1)
    assert relative([1.0, 2.2], [1.25, 2.0]) == pytest.approx(0.2)
    assert np.isnan(of_largest([np.nan, 1.0], [1.0, 1.0]))
