"""The four measured campaigns from `hsed init` to the report, against what their READMEs say is visible."""

import json

import pytest

from hsed_jax.run import main

pytestmark = pytest.mark.slow

CAMPAIGNS = ("steel_damper", "rc_column", "timber_connection", "friction_damper")
SMALL = ("calibration.starts=2", "calibration.chains=4", "calibration.warmup=60", "calibration.draws=150")

# What each README says is visible, and in which places of the loop a plain Bouc–Wen spring must therefore fail.  A test
# with growing cycles confounds late with large, so several coordinates may name one and the same effect.
LATE = {"time", "cycle", "energy"}
VISIBLE = {
    # "some isotropic hardening": strength grows with plastic work, so the misfit goes with the history.
    "steel_damper": LATE | {"amplitude"},
    # "stiffness degradation, mild strength degradation, some pinching, P-Delta": late, near zero force, or large.
    "rc_column": LATE | {"amplitude", "branch"},
    # "strong pinching, strength degradation within each group of cycles": near zero force, small elongations, or late.
    "timber_connection": LATE | {"amplitude", "branch"},
    # "backlash (zero force after every reversal), stick-slip, a direction asymmetry; degradation does not help".
    "friction_damper": {"branch", "sign of the force", "amplitude", "speed"},
}


@pytest.fixture(scope="module")
def runs(request, tmp_path_factory):
    """`hsed init` and `hsed run` of every campaign: exit status and summary."""
    shared = request.getfixturevalue("shared")
    found = {}
    for name in CAMPAIGNS:
        folder = shared / "data" / name
        if not folder.is_dir():
            pytest.skip(f"there is no folder {folder}")
        place = tmp_path_factory.mktemp(name)
        study, output = place / "study.yaml", place / "run"
        assert main(["init", str(folder), "--output", str(study)]) == 0
        status = main(["run", str(study), "--output", str(output), *SMALL])
        found[name] = status, json.loads((output / "summary.json").read_text(encoding="utf-8"))
        comparison = found[name][1]["comparison"]
        errors = {split: round(comparison[split]["error"], 3) for split in ("train", "test") if split in comparison}
        print(f"\n{name}: {errors}; " + " | ".join(place["sentence"] for place in comparison["where"][:3]))
    return found


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_study_of_a_measured_campaign_runs(runs, name):
    status, summary = runs[name]
    assert status == 0 and summary["status"] == "complete"
    assert {"train", "test"} <= summary["comparison"].keys()


def test_error_of_the_steel_damper_is_the_smallest(runs):
    errors = {name: summary["comparison"]["train"]["error"] for name, (_, summary) in runs.items()}
    assert min(errors, key=errors.get) == "steel_damper", errors


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_noise_does_not_explain_the_misfit_of_a_measured_campaign(runs, name):
    comparison = runs[name][1]["comparison"]
    assert not comparison["adequate"]
    assert comparison["train"]["error"] > 2 * comparison["train"]["noise_floor"]


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_the_misfit_is_where_the_readme_says_it_is_visible(runs, name):
    where = runs[name][1]["comparison"]["where"]
    assert where[0]["coordinate"] in VISIBLE[name], [place["sentence"] for place in where]
