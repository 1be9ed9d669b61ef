"""`hsed init`: a ready study for a campaign, which loads, passes its check, and whose priors hold the truth."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from builders.loops import BETA, A, loop
from builders.places import ROOT

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.config.load import load_study, parse_yaml
from hsed_jax.drafting.floors import floors_of
from hsed_jax.drafting.initial import text_of_study
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Channel, Noise, characteristics, read_campaign, write_campaign
from hsed_jax.study.build import Built


def component_campaign(noise=None) -> Campaign:
    time = np.linspace(0, 20, 801)
    elongation = 0.002 * time * np.sin(np.pi * time)
    force = loop(time, elongation) + 500 * np.random.default_rng(0).standard_normal(time.size)
    return Campaign.from_frames(
        records={"E01": {"time": time, "elongation": 1e3 * elongation, "force": force / 1e3}},
        name="a spring",
        protocol="displacement",
        channels={"time": "s", "elongation": "mm", "force": Channel("force", "kN", noise=noise)},
    )


MASS, STIFFNESS, STRENGTH = 2.0e4, 2.0e6, 5.0e4


def table_campaign() -> Campaign:
    """One mass on a Bouc–Wen spring on a shake table; force and absolute acceleration measured."""
    time = np.arange(0, 12, 0.02)
    ground = 4.0 * np.sin(2 * np.pi * 1.3 * time) * np.exp(-0.2 * time) * np.minimum(time, 1.0)
    u = v = z = 0.0
    rows, substeps = np.zeros((time.size, 3)), 40
    for k in range(1, time.size):
        for j in range(substeps):
            a = ground[k - 1] + (ground[k] - ground[k - 1]) * j / substeps
            h = 0.02 / substeps
            v += h * (-z / MASS - a)
            u += h * v
            z += h * (STIFFNESS * v - STIFFNESS / STRENGTH * abs(v) * z)
        rows[k] = u, z, -z / MASS
    channels = {"elongation": rows[:, 0], "force": rows[:, 1], "acceleration_1_absolute": rows[:, 2]}
    return Campaign.from_frames(
        records={"E01": {"time": time, "ground_acceleration": ground, **channels}},
        protocol="ground_motion",
        channels={
            "time": "s",
            "ground_acceleration": "m/s^2",
            "elongation": "m",
            "force": "N",
            "acceleration_1_absolute": "m/s^2",
        },
    )


def floors_campaign(**channels: str) -> Campaign:
    """The same test with sensors on the floor alone: by channel, the channel of `table_campaign` that it shows."""
    record = table_campaign()["E01"].record
    assert record is not None
    shown = {name: record[source] for name, source in channels.items()}
    units = {"displacement": "m", "elongation": "m", "acceleration": "m/s^2", "force": "N"}
    return Campaign.from_frames(
        records={"E01": {"time": record.time, "ground_acceleration": record["ground_acceleration"], **shown}},
        protocol="ground_motion",
        channels={"time": "s", "ground_acceleration": "m/s^2", **{n: units[n.split("_")[0]] for n in channels}},
    )


def quantities_campaign(inputs=None) -> Campaign:
    inputs = {"V_P": "m/s", "T_P": "s"} if inputs is None else inputs
    rows = [{"id": f"E0{i}", "peak_force": 90.0 + i, "peak_elongation": 20.0 + i, **{n: 1.0 + 0.1 * i for n in inputs}}
            for i in range(4)]  # fmt: skip
    return Campaign.from_frames(
        rows, protocol="ground_motion", inputs=inputs, quantities={"peak_force": "kN", "peak_elongation": "mm"}
    )


def init(folder: Path, campaign: Campaign, capsys):
    """Write the campaign, run `hsed init` and `hsed check`, and read the study."""
    write_campaign(campaign, folder)
    assert main(["init", str(folder)]) == 0
    path = folder / "study.yaml"
    assert str(path) in capsys.readouterr().out
    assert main(["check", str(path)]) == 0, capsys.readouterr().err
    return load_study(path), path.read_text(encoding="utf-8")


def central_95(built: Built, name: str) -> tuple[float, float]:
    return tuple(float(built.mechanics.parameters[0][name].quantile(share)) for share in (0.025, 0.975))  # type: ignore[return-value]


def holds(built: Built, **truth) -> bool:
    return all(low < truth[name] < high for name in truth for low, high in [central_95(built, name)])


OF_LAWS = {
    "bouc_wen": ("initial stiffness", "stiffness over strength", "first assumption"),
    "menegotto_pinto": ("initial stiffness", "yield force", "fits of the force leave", "with bouc_wen"),
}


def commented(text: str, law: str = "bouc_wen") -> bool:
    """Whether every guess is explained."""
    return all(word in text for word in (f"spring: {law}", *OF_LAWS[law], "none assumed"))


def test_study_of_a_component_test_has_priors_that_hold_the_truth(tmp_path, capsys):
    study, text = init(tmp_path / "spring", component_campaign(), capsys)
    built = Built(study)
    assert study.observe == "histories" and study.structure is None and built.experiments.component_test
    assert holds(built, A=A, beta=BETA)
    assert commented(text) and "the elongation was imposed" in text and "no noise, so it is inferred" in text
    assert study.steps == ["calibrate", "compare", "diagnose", "improve"]


def test_study_of_a_campaign_with_noise_says_that_it_is_declared(tmp_path, capsys):
    study, text = init(tmp_path / "spring", component_campaign(Noise(absolute=500.0)), capsys)
    assert "as the campaign declares it for force" in text
    assert [error.size for error in Built(study).observed.errors] == [500.0]


def test_study_of_a_shake_table_test_has_the_mass_and_priors_that_hold_the_truth(tmp_path, capsys):
    study, text = init(tmp_path / "table", table_campaign(), capsys)
    assert study.structure.masses[0] == pytest.approx(MASS, rel=1e-3)
    assert holds(Built(study), A=STIFFNESS, beta=STIFFNESS / STRENGTH)
    assert "regression of force on absolute acceleration in E01" in text and commented(text)
    assert study.excitation is None


FLOORS = [
    {"displacement_1": "elongation"},
    {"acceleration_1_absolute": "acceleration_1_absolute"},
    {"elongation": "elongation"},
    {"displacement_1": "elongation", "force": "force"},
]


@pytest.mark.parametrize("channels", FLOORS)
def test_study_of_floor_sensors_has_priors_that_hold_the_truth_per_mass(tmp_path, capsys, channels):
    study, text = init(tmp_path / "floors", floors_campaign(**channels), capsys)
    (mass,) = study.structure.masses
    assert holds(Built(study), A=STIFFNESS / MASS * mass, beta=STIFFNESS / STRENGTH) and commented(text)
    if "force" in channels:
        assert 0.25 < mass / MASS < 4
    else:
        assert "a placeholder, because no force was measured" in text


@pytest.mark.parametrize("factor", [0.05, 1.0, 1.5, 4.5, 20.0])
def test_masses_that_are_changed_without_the_stiffness_are_doubted_with_what_to_write(tmp_path, capsys, factor):
    study, text = init(tmp_path / "floors", floors_campaign(displacement_1="elongation"), capsys)
    path = tmp_path / "floors" / "study.yaml"
    (line,) = (line for line in text.splitlines() if "masses:" in line)
    changed = text.replace(line, f"  masses: [{factor * study.structure.masses[0]}]")
    path.write_text(changed, encoding="utf-8")
    assert main(["check", str(path)]) == 0
    said = capsys.readouterr().out
    if factor in (1.0, 1.5):  # what the prior allows is no doubt
        assert "first frequency" not in said
        return
    assert f"other masses need other stiffnesses, here by a factor of about {factor:.2g}" in said
    prior = re.search(r"A: \{lognormal: \[([\d.]+), 0.7\]\}", said)
    assert prior is not None
    first = next(line for line in changed.splitlines() if "    A: " in line)
    path.write_text(changed.replace(first, f"    {prior[0]}"), encoding="utf-8")
    assert main(["check", str(path)]) == 0
    assert "first frequency" not in capsys.readouterr().out
    built = Built(load_study(path))
    assert holds(built, A=STIFFNESS / MASS * factor * study.structure.masses[0])


@pytest.mark.whole
def test_a_calibration_and_its_comparison_say_that_masses_do_not_go_with_the_stiffness(tmp_path, capsys):
    study, _ = init(tmp_path / "floors", floors_campaign(displacement_1="elongation"), capsys)
    structure = study.structure.model_copy(update={"masses": [MASS]})
    quick = study.calibration.model_copy(update={"sampler": "laplace", "starts": 1})
    fit = hx.calibrate(study.model_copy(update={"structure": structure, "calibration": quick}))
    for told in (fit, hx.compare(fit)):
        assert "other masses need other stiffnesses" in repr(told)


def test_study_of_several_floors_has_a_storey_for_each(tmp_path, capsys):
    sensors = {f"acceleration_{floor}_absolute": "acceleration_1_absolute" for floor in (1, 3)}
    study, text = init(tmp_path / "floors", floors_campaign(**sensors), capsys)
    assert study.structure.masses == [1000.0] * 3 and "3 equal storeys" in text
    assert [spring.between for spring in study.structure.springs] == [(1, 2), (2, 3)]
    frequencies = Built(study).mechanics.structure.frequencies(study.structure.damping.specimen_stiffness)
    said = float(text.split("first frequency is ")[1].split()[0])
    assert float(frequencies[0]) == pytest.approx(said, rel=0.01)


@pytest.mark.parametrize("left_out", ["d1 d2", "a1 a2", ""])
def test_first_frequency_is_not_the_second_where_the_first_mode_yields(tmp_path, monkeypatch, left_out):
    monkeypatch.syspath_prepend(ROOT / "docs")
    import guide_cases

    guide_cases.frame(tmp_path)
    table = pd.read_csv(tmp_path / "shaking.csv")
    kinds = {"d1": ("displacement_1", 1e-3), "d2": ("displacement_2", 1e-3),
             "a1": ("acceleration_1_absolute", 9.80665), "a2": ("acceleration_2_absolute", 9.80665)}  # fmt: skip
    shown = {name: factor * table[key] for key, (name, factor) in kinds.items() if key not in left_out.split()}
    campaign = Campaign.from_frames(
        records={"E01": {"time": table["t"], "ground_acceleration": 9.80665 * table["table"], **shown}},
        protocol="ground_motion",
        channels={"time": "s", "ground_acceleration": "m/s^2"}
        | {name: "m" if name.startswith("d") else "m/s^2" for name in shown},
    )
    # Of the virgin frame, which softens by an eighth: the second is 7.7 Hz.
    matrix = np.array([[(1.2e6 + 1.6e6) / 1.8e3, -1.6e6 / 1.8e3], [-1.6e6 / 1.5e3, 1.6e6 / 1.5e3]])
    first = np.sqrt(np.linalg.eigvals(matrix).min()) / (2 * np.pi)
    assert 0.7 * first < floors_of(campaign).frequency < 1.05 * first


def test_scales_of_floor_sensors_are_those_of_the_plain_model(tmp_path, capsys):
    study, _ = init(tmp_path / "floors", floors_campaign(displacement_1="elongation"), capsys)
    record = table_campaign()["E01"].record
    law = study.model.model_copy(
        update={"parameters": {"A": {"lognormal": [np.log(STIFFNESS), 0.1]}, "beta": STIFFNESS / STRENGTH},
                "effects": {"strength_degradation": {}}}
    )  # fmt: skip
    structure = study.structure.model_copy(update={"masses": [MASS]})
    built = Built(study.model_copy(update={"model": law, "structure": structure}))
    energy = np.trapezoid(record["force"], record["elongation"])
    expected = np.abs(record["force"]).max(), np.abs(record["elongation"]).max(), energy
    # Two per cent of modal damping are the model's alone.
    assert (
        built.simulation.scales.force,
        built.simulation.scales.elongation,
        built.simulation.scales.energy,
    ) == pytest.approx(expected, rel=0.1)
    assert 0.02 < built.simulation.scales.rate < 2.0


def test_after_errors_of_the_data_nothing_is_said_of_what_was_not_measured(tmp_path, capsys):
    campaign = component_campaign()
    record = campaign["E01"].record
    force = record["force"].copy()
    force[400] = np.nan
    broken = {"time": record.time, "elongation": record["elongation"], "force": force}
    channels = {"time": "s", "elongation": "m", "force": "N"}
    write_campaign(
        Campaign.from_frames(records={"E01": broken}, protocol="displacement", channels=channels), tmp_path / "c"
    )
    assert main(["init", str(tmp_path / "c")]) == 2
    said = capsys.readouterr()
    assert "1 of 801 samples are not numbers" in said.out and "errors, listed above" in said.err
    assert "not both measured" not in said.err and not (tmp_path / "c" / "study.yaml").exists()


@pytest.mark.whole
def test_a_suspected_sign_flip_has_to_be_acknowledged(tmp_path, capsys):
    campaign, folder = component_campaign(), tmp_path / "c"
    record = campaign["E01"].record
    flipped = {"time": record.time, "elongation": record["elongation"], "force": -record["force"]}
    channels = {"time": "s", "elongation": "m", "force": "N"}
    write_campaign(Campaign.from_frames(records={"E01": flipped}, protocol="displacement", channels=channels), folder)
    assert main(["init", str(folder)]) == 0
    study, run = str(folder / "study.yaml"), tmp_path / "run"
    for command in (["check", study], ["run", study, "--output", str(run)]):
        assert main(command) == 2 and not run.exists()
        assert "accept it in the study: measurements: {accept: {E01: sign}}" in capsys.readouterr().err
    for accepted in ('["E01": sign]', "{all: sign}", "{E01: [offset, sign]}"):
        assert main(["check", study, f"measurements.accept={accepted}"]) == 0
        assert "is a sign flipped? (accepted)" in capsys.readouterr().out
    for entry, message in (
        ("{E9: sign}", "measurements.accept: there is no measured experiment 'E9'; measured are E01"),
        ("{E01: sgin}", "measurements.accept"),
        ("sign", "measurements.accept"),
    ):
        assert main(["check", study, f"measurements.accept=[{entry}]"]) == 2
        assert message in capsys.readouterr().err


def test_study_of_quantities_alone_has_an_excitation_to_begin_with(tmp_path, capsys):
    study, text = init(tmp_path / "numbers", quantities_campaign(), capsys)
    assert study.observe == "quantities" and study.quantities == ["peak_force", "peak_elongation"]
    assert (study.excitation.near_fault_pulse.V_P, study.excitation.near_fault_pulse.T_P) == ("V_P", "T_P")
    assert study.written()["inputs"]["V_P"] == {"uniform": [1.0, 1.3], "unit": "m/s"}
    assert "describe yours here" in text and commented(text)


@pytest.mark.parametrize("inputs", [{"S": "1"}, {"yes": "-"}, {"speed": "cm/s", "period": "ms"}, {}])
def test_any_names_and_units_of_inputs_make_a_study_that_loads(tmp_path, capsys, inputs):
    study, text = init(tmp_path / "numbers", quantities_campaign(inputs), capsys)
    assert set(study.inputs) == set(inputs)
    pulse = study.excitation.near_fault_pulse
    if "speed" in inputs:
        assert (pulse.V_P, pulse.T_P) == ("speed", "period")
    else:
        assert (pulse.V_P, pulse.T_P) == (1.0, 1.0) and "placeholders" in text


@pytest.mark.parametrize("name", ["2024", "a: b", "with # sign", "true", "ümläut"])
def test_any_name_of_the_folder_makes_a_study_that_loads(tmp_path, capsys, name):
    study, text = init(tmp_path / name, component_campaign(), capsys)
    assert isinstance(study.study, str)
    assert parse_yaml(text, "text")["experiments"]["campaign"] == "."


def test_study_may_stand_elsewhere_than_the_campaign(tmp_path, capsys):
    write_campaign(component_campaign(), tmp_path / "data" / "no: 1")
    output = tmp_path / "study of it.yaml"
    assert main(["init", str(tmp_path / "data" / "no: 1"), "--output", str(output)]) == 0
    assert main(["check", str(output)]) == 0
    assert load_study(output).experiments.campaign == "data/no: 1"


def test_an_existing_study_is_refused_and_left_alone(tmp_path, capsys):
    init(tmp_path / "spring", component_campaign(), capsys)
    path = tmp_path / "spring" / "study.yaml"
    path.write_text("mine", encoding="utf-8")
    assert main(["init", str(tmp_path / "spring")]) == 2
    assert "exists already" in capsys.readouterr().err and path.read_text(encoding="utf-8") == "mine"
    assert main(["init", str(tmp_path / "spring"), "--force"]) == 0
    assert path.read_text(encoding="utf-8") != "mine"


def test_what_cannot_start_a_study_is_said():
    time = np.linspace(0, 1, 50)
    only = Campaign.from_frames(
        records={"E01": {"time": time, "elongation": np.sin(9 * time)}},
        protocol="displacement",
        channels={"time": "s", "elongation": "mm"},
    )
    with pytest.raises(UserError, match="neither force and elongation nor the motion of a floor"):
        text_of_study(only, Path("x"), Path("x/study.yaml"))
    with pytest.raises(UserError, match="no completed training experiment"):
        text_of_study(Campaign("empty", "ground_motion"), Path("x"), Path("x/study.yaml"))
    numbers = Campaign.from_frames(
        [{"id": "E01", "peak_force": 1.0, "peak_elongation": 1.0}],
        protocol="displacement",
        quantities={"peak_force": "kN", "peak_elongation": "mm"},
    )
    with pytest.raises(UserError, match="no experiment has a record of the elongation"):
        text_of_study(numbers, Path("x"), Path("x/study.yaml"))


def test_characteristic_values_of_a_campaign_are_those_of_its_loop():
    found = characteristics(component_campaign())
    record = component_campaign()["E01"].record
    # A secant up to a tenth of the peak, 4 mm with 5 mm of yield elongation.  Measured: 0.82 of the tangent.
    assert 0.5 * A < found.stiffness <= 1.05 * A
    assert found.force == np.abs(record["force"]).max() and found.elongation == np.abs(record["elongation"]).max()
    assert found.energy == pytest.approx(np.trapezoid(record["force"], record["elongation"]))
    assert 0.6 * 0.04 * np.pi < found.rate < 1.1 * 0.04 * np.pi


@pytest.mark.whole
@pytest.mark.parametrize("name", ["steel_damper", "rc_column", "timber_connection", "friction_damper"])
def test_study_of_a_measured_campaign_passes_its_check(shared, tmp_path, capsys, name):
    folder = shared / "data" / name
    if not folder.is_dir():
        pytest.skip(f"there is no folder {folder}")
    output = tmp_path / "study.yaml"
    assert main(["init", str(folder), "--output", str(output)]) == 0
    assert main(["check", str(output)]) == 0, capsys.readouterr().err
    text, built = output.read_text(encoding="utf-8"), Built(load_study(output))
    law = "menegotto_pinto" if name == "steel_damper" else "bouc_wen"
    assert commented(text, law) and built.experiments.component_test
    found = characteristics(read_campaign(folder))
    low, high = central_95(built, "k" if name == "steel_damper" else "A")
    assert low < found.stiffness < high
