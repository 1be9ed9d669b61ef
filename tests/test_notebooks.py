"""The lessons are sound scripts: title, cells, no outputs, and every file and name that they use exists.

They are executed, with errors raised, when the documentation is built.
"""

import ast
import re
from pathlib import Path

import pytest

import hsed_jax as hx

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
LESSONS = sorted(FOLDER.glob("*.py"))


def cells(text):
    """(is text, lines) of every cell of a percent script, its header left out."""
    _, *found = re.split(r"^# %%(?P<kind>.*)\n", text, flags=re.MULTILINE)
    return [
        (kind.strip() == "[markdown]", body.strip().splitlines())
        for kind, body in zip(found[::2], found[1::2], strict=True)
    ]


def faults(text):
    """What is wrong with a lesson."""
    found, parts = [], cells(text)
    header = text.split("# %%")[0]
    if not ("format_name: percent" in header and "name: python3" in header):
        found.append("no jupytext header")
    kinds = [is_text for is_text, _ in parts]
    if not parts or not kinds[0] or not re.fullmatch(r"# # \S.*", parts[0][1][0]):
        found.append("the first cell is no title")
    if not (parts and kinds[-1]):
        found.append("it does not end with what was seen")
    marks = "".join("t" if is_text else "c" for is_text in kinds)
    if "tt" in marks or "ccccc" in marks:
        found.append("cells do not alternate")
    for is_text, lines in parts:
        if is_text and not all(line == "#" or line.startswith("# ") for line in lines):
            found.append("a text cell holds code")
        if not is_text and (len(lines) > 18 or not lines):
            found.append(f"a code cell of {len(lines)} lines")
    for path in re.findall(r"\.\./[\w/.-]+\.\w+", text):
        if not (FOLDER / path).is_file():
            found.append(f"there is no {path}")
    for module, name in re.findall(r"\bhx\.(plot\.)?(\w+)", text):
        if not hasattr(hx.plot if module else hx, name):
            found.append(f"there is no hx.{module}{name}")
    return found


@pytest.mark.parametrize("path", LESSONS, ids=lambda path: path.stem)
def test_a_lesson_is_sound(path):
    text = path.read_text(encoding="utf-8")
    ast.parse(text)
    assert faults(text) == []


def test_there_are_lessons_and_no_outputs_beside_them():
    assert len(LESSONS) >= 4
    assert not list(FOLDER.glob("*.ipynb"))
    assert all(re.fullmatch(r"\d\d_[a-z_]+", path.stem) for path in LESSONS)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("format_name: percent", "format_name: light", "header"),
        ("# # Which", "# Which", "title"),
        ("paper.yaml", "papers.yaml", "papers.yaml"),
        ("hx.plot.exploration", "hx.plot.explore", "hx.plot.explore"),
        ("hx.simulate", "hx.simulates", "hx.simulates"),
        ("# %%\nimport", "# %% [markdown]\nimport", "alternate"),
        ("# %%\nimport", "# %% [markdown]\nimport", "text cell holds code"),
        ("study\n", "study\n" + 20 * "study\n", "lines"),
    ],
)
def test_the_check_can_fail(old, new, fault):
    text = (FOLDER / "01_paper.py").read_text(encoding="utf-8")
    assert old in text
    assert any(fault in found for found in faults(text.replace(old, new, 1)))
