"""The benchmarks run, their accuracy holds, and no ratio has gone out of bounds: ratios, since seconds depend on the machine."""

import json
import subprocess
import sys

import pytest
from builders.places import ROOT

RUN = ROOT / "benchmarks" / "run.py"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What `python benchmarks/run.py simulate --quick` measures."""
    output = tmp_path_factory.mktemp("benchmarks") / "results.json"
    command = [sys.executable, str(RUN), "simulate", "--quick", "--output", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "our cost / peer's" in done.stdout
    return json.loads(output.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def work(results):
    """The lines by the first word of the work that tells them apart."""
    names = ("batch", "alone", "histories", "jacobian", "public")
    return dict(zip(names, results["lines"], strict=True))


def test_results_say_what_was_measured_where(results):
    assert results["quick"] is True
    assert {"cpu", "cores", "load", "python", "versions", "date"} <= set(results["machine"])
    for entry in results["lines"]:
        assert set(entry) == {"row", "work", "ratios", "unit", "ours", "peers", "accuracy", "notes"}
        assert entry["ours"] > 0
        assert entry["ratios"] == {name: entry["ours"] / cost for name, cost in entry["peers"].items()}


def test_accuracy_is_that_of_the_promise(work):
    for error in work["batch"]["accuracy"].values():
        assert error["peaks"] <= 1e-4
        assert error["energy"] <= 5e-4


# Twice to three times what a quiet machine shows, since this one may be busy.
@pytest.mark.parametrize(
    ("name", "peer", "limit"),
    [
        ("batch", "C", 4.0),
        ("batch", "numba", 0.6),
        ("alone", "C", 5.0),
        ("histories", "quantities alone", 3.0),
        ("jacobian", "values alone", 9.0),
    ],
)
def test_no_ratio_has_gone_out_of_bounds(work, name, peer, limit):
    ratios = work[name]["ratios"]
    if peer not in ratios:
        pytest.skip("; ".join(work[name]["notes"]))
    assert ratios[peer] <= limit
