"""The examples of the public functions run, and every public function has one: in its docstring, a notebook or the README."""

import doctest
import inspect
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from builders.places import ROOT

import hsed_jax as hx

PUBLIC = {name: getattr(hx, name) for name in dir(hx) if callable(getattr(hx, name))}
FOUND = {
    name: [test for test in doctest.DocTestFinder(recurse=False).find(item, name) if test.examples]
    for name, item in PUBLIC.items()
}


@pytest.fixture
def laboratory(tmp_path, monkeypatch):
    """The files that examples read: a test in one file, the same as a campaign, a ground motion, a study."""
    monkeypatch.chdir(tmp_path)
    cycles = [a * np.sin(np.linspace(0, 2 * np.pi, 81)[1:]) for a in (2.0, 4.0, 6.0, 8.0, 10.0, 12.0)]
    drift = np.concatenate([[0.0], *cycles])
    force = 10 * np.clip(drift, -3 + drift / 10, 3 + drift / 10)
    pd.DataFrame({"drift (mm)": drift, "force (kN)": force}).to_csv("wall.csv", index=False)
    header = (
        "PEER STRONG MOTION DATABASE RECORD\nA TEST\nACCELERATION TIME HISTORY IN UNITS OF G\nNPTS= 4, DT= .0100 SEC\n"
    )
    Path("motion.AT2").write_text(header + "  0.1 0.2 -0.1 0.0\n")
    shutil.copy(ROOT / "configs" / "paper.yaml", "study.yaml")
    hx.write_campaign(hx.read_files("wall.csv", held_out=0.0), "my_campaign")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of a virtual specimen that has calibrated a law."""
    steps = ["steps=[calibrate]", "calibration.sampler=laplace", "calibration.starts=2", "design.initial=3"]
    folder = tmp_path_factory.mktemp("finished") / "wall"
    hx.run(hx.load_study(ROOT / "configs" / "paper.yaml", steps), folder, progress=False, figures=False)
    return folder


@pytest.mark.parametrize("name", [name for name, tests in FOUND.items() if tests])
def test_an_example_shows_what_comes_out(name, laboratory, request):
    if "runs/wall" in (PUBLIC[name].__doc__ or ""):
        shutil.copytree(request.getfixturevalue("finished"), "runs/wall")
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    said: list[str] = []
    for test in FOUND[name]:
        test.globs = {"hx": hx, "np": np}
        runner.run(test, out=said.append)
    assert runner.failures == 0, "".join(said)


def test_every_public_function_has_an_example_that_is_executed():
    executed = [*(ROOT / "notebooks" / "text").glob("*.py"), ROOT / "README.md"]
    called = set(re.findall(r"\bhx\.(\w+)\(", "".join(path.read_text(encoding="utf-8") for path in executed)))
    functions = {name for name, item in PUBLIC.items() if inspect.isfunction(item)}
    assert sorted(functions - called - {name for name, tests in FOUND.items() if tests}) == []
