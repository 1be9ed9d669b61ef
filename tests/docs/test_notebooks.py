"""The notebooks are sound: title, cells, every file and name that they use; the text form of each is the notebook.

`.ci/notebooks.py` executes them and compares what comes out with what they show.
"""

import ast
import importlib.util
import json
import re

import pytest
from builders.places import ROOT

import hsed_jax as hx

FOLDER = ROOT / "notebooks"
LESSONS = sorted((FOLDER / "text").glob("*.py"))


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


def notebook(path):
    return json.loads((FOLDER / f"{path.stem}.ipynb").read_text(encoding="utf-8"))


def plain(is_text, lines):
    """The lines of a cell of a percent script as a notebook holds them."""
    return [line.removeprefix("#").removeprefix(" ") for line in lines] if is_text else lines


@pytest.mark.parametrize("path", LESSONS, ids=lambda path: path.stem)
def test_a_notebook_has_the_cells_of_its_text_form_and_their_outputs(path):
    kept = notebook(path)["cells"]
    shown = [(c["cell_type"] == "markdown", "".join(c["source"]).strip().splitlines()) for c in kept]
    assert shown == [(is_text, plain(is_text, lines)) for is_text, lines in cells(path.read_text(encoding="utf-8"))]
    code = [c for c in kept if c["cell_type"] == "code"]
    # It was executed from its first cell to its last, and no cell failed.
    assert [c["execution_count"] for c in code] == list(range(1, len(code) + 1))
    outputs = [output for c in code for output in c["outputs"]]
    assert outputs and all(output["output_type"] != "error" for output in outputs)


def test_every_notebook_has_a_text_form_and_is_small():
    assert [path.stem for path in sorted(FOLDER.glob("*.ipynb"))] == [path.stem for path in LESSONS]
    assert all(re.fullmatch(r"\d\d_[a-z_]+", path.stem) for path in LESSONS)
    assert max(path.stat().st_size for path in FOLDER.glob("*.ipynb")) < 600_000


def test_the_first_notebook_goes_from_a_file_to_a_named_effect_in_ten_cells():
    kept = notebook(LESSONS[0])["cells"]
    assert len(kept) <= 10
    said = json.dumps([c.get("outputs", []) for c in kept])
    assert "missing_effects: missing is strength_degradation" in said


def difference(printed, shown):
    spec = importlib.util.spec_from_file_location("same", FOLDER.parent / ".ci" / "same.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.difference(printed, shown)


@pytest.mark.parametrize(
    ("printed", "shown", "differs"),
    [
        ("error 0.263 to 0.050", "error 0.262 to 0.0501", False),
        ("p = 1.0e-05", "p = 9e-06", False),  # below what is told apart
        ("error 0.263", "error 0.30", True),
        ("A 4.998e+05", "A 3.9e+05", True),
        ("missing is slip", "missing is pinching", True),
        ("missing is slip", "missing is slip and pinching", True),
        ("A   1.0   2.0", "A 1.0 2.0", False),
    ],
)
def test_outputs_are_compared_by_words_and_rounded_numbers(printed, shown, differs):
    assert (difference(printed, shown) is not None) == differs


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
    text = (FOLDER / "text" / "01_paper.py").read_text(encoding="utf-8")
    assert old in text
    assert any(fault in found for found in faults(text.replace(old, new, 1)))
