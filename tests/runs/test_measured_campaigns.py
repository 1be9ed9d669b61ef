"""The four measured campaigns from `hsed init` to the report, against what their READMEs say is visible."""

import json

import pytest

from hsed_jax.command_line import main

pytestmark = pytest.mark.slow

CAMPAIGNS = ("steel_damper", "rc_column", "timber_connection", "friction_damper")
SMALL = ("calibration.starts=2", "calibration.chains=4", "calibration.warmup=60", "calibration.draws=150")

LATE = {"time", "cycle", "energy"}


def early(place) -> float:
    """Bias of the model early in the test (negative: too weak), of a place that separates early from late."""
    return place["bias"] if place["part"] == "below" else -place["bias"]


def hardens(place) -> bool:
    """Strength grows with the history: a model of constant strength is too strong early."""
    return place["coordinate"] in LATE and early(place) > 0


def degrades(place) -> bool:
    """Stiffness or strength falls with the history: the model is too weak early and too strong late."""
    return place["coordinate"] in LATE and early(place) < 0


def slack_or_asymmetric(place) -> bool:
    """No force after reversals, or another force in the other direction."""
    return place["coordinate"] in ("branch", "sign of the force")


# What each README says is visible, as the first place must show it.  Two do not, and are not made to:
# steel_damper ("some isotropic hardening"): the model is too weak in the first, small cycles, the reverse of hardening (perhaps
# n = 1 yields too early there; not tested).  friction_damper ("backlash, stick-slip, a direction asymmetry"): the first place is
# elongations above 2 mm without a direction; neither branch nor sign of the force come first.
# rc_column and timber_connection show their degradation; their pinching comes only far down the list (sixth and fourth).
VISIBLE = [
    pytest.param("rc_column", degrades),
    pytest.param("timber_connection", degrades),
    pytest.param("steel_damper", hardens, marks=pytest.mark.xfail(strict=True, reason="the bias has the other sign")),
    pytest.param("friction_damper", slack_or_asymmetric, marks=pytest.mark.xfail(strict=True, reason="not located")),
]


@pytest.fixture(scope="module")
def runs(request, tmp_path_factory):
    """`hsed init` and `hsed compare` of every campaign: exit status and summary."""
    shared = request.getfixturevalue("shared")
    found = {}
    for name in CAMPAIGNS:
        folder = shared / "data" / name
        if not folder.is_dir():
            pytest.skip(f"there is no folder {folder}")
        place = tmp_path_factory.mktemp(name)
        study, output = place / "study.yaml", place / "run"
        assert main(["init", str(folder), "--output", str(study)]) == 0
        status = main(["compare", str(study), "--output", str(output), *SMALL])
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


@pytest.mark.parametrize(("name", "shown"), VISIBLE)
def test_the_first_sentence_shows_what_the_readme_says_is_visible(runs, name, shown):
    where = runs[name][1]["comparison"]["where"]
    assert shown(where[0]), [place["sentence"] for place in where]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "share"), [("rc_column", 0.5), ("timber_connection", 2 / 3)])
def test_what_is_named_lets_the_held_out_error_fall(shared, tmp_path, name, share):
    """Down by half on the column, by a third on the connection, without touching a line of the study."""
    folder = shared / "data" / name
    if not folder.is_dir():
        pytest.skip(f"there is no folder {folder}")
    study, output = tmp_path / "study.yaml", tmp_path / "run"
    assert main(["init", str(folder), "--output", str(study)]) == 0
    assert main(["run", str(study), "--output", str(output), *SMALL]) == 0
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    first, last = summary["improvement"]["steps"][0], summary["improvement"]["steps"][-1]
    assert last["error_test"] < share * first["error_test"]
    # A specimen of concrete or wood slips and pinches.
    families = {c["effect"]: c["family"] for c in summary["diagnosis"]["ranking"]}
    assert "pinching" in {families[effect] for effect in summary["diagnosis"]["effects"]}
    assert "remaining" in summary["diagnosis"]
