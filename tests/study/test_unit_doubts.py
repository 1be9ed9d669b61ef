"""Units that are wrong for a whole record are doubted; specimens, campaigns and frames as they are give no doubt."""

from dataclasses import replace

import numpy as np
import pytest
from builders.places import DATA

from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.measurements import Campaign, Channel, Experiment, Record, check_campaign, read_campaign, write_campaign
from hsed_jax.study.build import Built
from hsed_jax.study.unit_doubts import drift_doubts, unit_doubts

AMPLITUDES = (2, 4, 8, 12)


def record(scale=1.0, strength=3e4, stiffness=1e7, seed=0, **factors) -> Record:
    """Growing cycles [m], [N] of a rounded elastoplastic specimen with noise; channels times factors."""
    cycles = np.repeat(AMPLITUDES, 2)
    u = 1e-3 * scale * np.concatenate([a * np.sin(2 * np.pi * np.arange(60) / 60) for a in cycles])
    force = np.zeros_like(u)
    for i in range(1, u.size):
        step = u[i] - u[i - 1]
        force[i] = force[i - 1] + stiffness * step * (
            1 - (0.5 + 0.5 * np.sign(force[i - 1] * step)) * abs(force[i - 1] / strength)
        )
    draw = np.random.default_rng(seed)
    channels = {"elongation": u + 1e-6 * draw.normal(size=u.size), "force": force + 30 * draw.normal(size=u.size)}
    return Record(np.arange(u.size, dtype=float), {n: factors.get(n, 1.0) * v for n, v in channels.items()})


def campaign(*records: Record, inputs=None, values=()) -> Campaign:
    channels = {"elongation": Channel("elongation", "mm"), "force": Channel("force", "kN")}
    given = [dict(zip(inputs or {}, row, strict=True)) for row in values] or [{} for _ in records]
    experiments = [Experiment(f"E{k}", given[k], record=one) for k, one in enumerate(records, start=1) for k in [k - 1]]
    return Campaign("x", "displacement", inputs or {}, channels, experiments=tuple(experiments))


def doubts(of: Campaign) -> list[tuple[str, str]]:
    return [(f.experiment, f.channel) for f in check_campaign(of) if f.kind == "unit"]


SPECIMENS = [record(seed=k, strength=3e4 * s, stiffness=1e7 * s) for k, s in enumerate((1.0, 1.3, 0.8, 1.1))]
FACTORS = [("force", 9.80665), ("force", 1000.0), ("force", 4448.22), ("elongation", 10.0), ("elongation", 25.4),
           ("elongation", 1000.0)]  # fmt: skip


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("channel", "factor"), FACTORS)
@pytest.mark.parametrize("count", [2, 4])
def test_one_experiment_in_another_unit_is_doubted(count, channel, factor, turned):
    factor = 1 / factor if turned else factor
    wrong = record(seed=9, **{channel: factor})
    found = [f for f in check_campaign(campaign(*SPECIMENS[: count - 1], wrong)) if f.kind == "unit"]
    (finding,) = [f for f in found if " mixed?" in f.message]
    assert (finding.experiment, finding.channel) == (f"E{count - 1}", channel)
    assert finding.setting == f"accept: {{E{count - 1}: unit}}"
    # The number that is said is the factor that was put in, but for what the specimens differ by.
    said = finding.message.split(" it is ")[1].split(" ")[0]
    number = 1 / float(said[2:]) if said.startswith("1/") else float(said)
    assert number == pytest.approx(factor, rel=0.35)


@pytest.mark.parametrize("strength", [2.0, 5.0, 20.0])
def test_specimens_that_differ_otherwise_are_no_doubt(strength):
    other = record(seed=9, strength=3e4 * strength, stiffness=1e7 * strength)
    assert doubts(campaign(*SPECIMENS[:2], other)) == []
    assert doubts(campaign(SPECIMENS[0], record(scale=0.1, seed=9))) == []


def test_of_two_experiments_with_other_inputs_one_may_be_ten_times_as_strong():
    strong = record(seed=9, strength=3e5, stiffness=1e8)
    assert doubts(campaign(SPECIMENS[0], strong)) == [("E1", "force")]
    assert doubts(campaign(SPECIMENS[0], strong, inputs={"tension": "N"}, values=[(10.0,), (100.0,)])) == []


def test_amplitudes_that_follow_an_input_tell_the_unit():
    scales = (0.5, 1.0, 2.0, 1.5)
    peaks = [max(AMPLITUDES) * 1e-3 * s for s in scales]

    def of(factors, share=1.0):
        records = [record(s, seed=k, elongation=f) for k, (s, f) in enumerate(zip(scales, factors, strict=True))]
        return campaign(*records, inputs={"a": "mm"}, values=[(share * p,) for p in peaks])

    assert doubts(of([1, 1, 1, 1])) == []
    assert doubts(of([1, 1, 1, 1], share=0.3)) == []  # any other length of the specimen
    assert doubts(of([25.4] * 4)) == [(f"E{k}", "elongation") for k in range(4)]
    found = [f for f in check_campaign(of([1, 1, 1 / 25.4, 1])) if f.kind == "unit"]
    assert [(f.experiment, f.channel) for f in found] == [("E2", "elongation")] and "mm and inch" in found[0].message


USUAL = {("m", "N"): (0.012, 3e4), ("rad", "N*m"): (0.02, 1e5), ("-", "Pa"): (0.01, 4e8)}
ABSURD = [
    ("m", "N", 1.0, 50.0),
    ("m", "N", 1e-4, 1e8),
    ("rad", "N*m", 1.0, 0.5),
    ("-", "Pa", 0.5, 2e3),
    ("-", "Pa", 1e-4, 5e8),
]


@pytest.mark.parametrize(("unit", "force_unit", "elongation", "force"), ABSURD)
def test_a_stiffness_that_no_specimen_has_is_doubted(unit, force_unit, elongation, force):
    one = record()
    shapes = {name: values / np.abs(values).max() for name, values in one.channels.items()}
    channels = {"elongation": Channel("elongation", unit), "force": Channel("force", force_unit)}

    def of(*peaks):
        scaled = {name: peak * shapes[name] for name, peak in zip(("elongation", "force"), peaks, strict=True)}
        measured = Experiment("E1", record=Record(one.time, scaled))
        return check_campaign(Campaign("x", "displacement", channels=channels, experiments=(measured,)))

    assert [f for f in of(*USUAL[unit, force_unit]) if f.kind == "unit"] == []
    (finding,) = [f for f in of(elongation, force) if f.kind == "unit"]
    assert finding.channel == "force" and f" is {force / elongation:.2g} " in finding.message


def test_a_fast_motion_of_a_small_model_is_no_wrong_unit():
    time = np.arange(4000) / 2000
    channels = {
        n: Channel(n, u) for n, u in (("time", "s"), ("ground_acceleration", "m/s^2"), ("displacement_1", "mm"))
    }

    def of(frequency):
        a = 90 * np.sin(2 * np.pi * frequency * time) * np.sin(np.pi * time / 2) ** 2
        motion = Record(time, {"ground_acceleration": a, "displacement_1": a * 1e-6})
        return Campaign("x", "ground_motion", channels=channels, experiments=(Experiment("E1", record=motion),))

    # 90 m/s² at 60 Hz are 0.24 m/s, at 2 Hz 7.2 m/s.
    assert doubts(of(60)) == [] and doubts(of(2)) == [("E1", "ground_acceleration")]


STUDY = """
study: x
structure:
  masses: [{mass}]
  springs: []
  specimen: {{between: [ground, 1]}}
  damping: {{modal: 0.02, specimen_stiffness: 1.0e7}}
excitation: {{near_fault_pulse: {{V_P: v, T_P: 1.0, gamma: 2.0, nu: 0.1}}, duration: 5.0}}
inputs: {{v: {{uniform: [0.5, 1.5], unit: m/s}}}}
model: {{spring: bouc_wen, parameters: {{A: {{uniform: [0.5e7, 1.5e7]}}, beta: 100.0, gamma: 0.0, n: 1.0}}}}
experiments: {{virtual: {{parameters: {{A: 1.0e7, beta: 100.0, gamma: 0.0, n: 1.0}}, effects: {{}}}}}}
observe: histories
steps: [calibrate]
"""


@pytest.mark.parametrize(("mass", "period"), [(2.5e5, None), (2.5e8, 31.4), (0.2, 8.89e-4)])
def test_a_period_that_no_frame_has_is_doubted(tmp_path, mass, period):
    # T = 2π sqrt(m/k), with k = 1e7 N/m in the middle of its prior.
    (tmp_path / "s.yaml").write_text(STUDY.format(mass=mass))
    found = unit_doubts(Built(load_study(tmp_path / "s.yaml")))
    assert len(found) == (period is not None)
    if period is not None:
        assert found[0].kind == "unit" and found[0].setting == "accept: {all: unit}"
        assert float(found[0].message.split(" is ")[1].split(" ")[0]) == pytest.approx(period, rel=5e-3)


def test_a_period_is_accepted_by_the_setting_that_is_said(tmp_path, capsys):
    (tmp_path / "s.yaml").write_text(STUDY.format(mass=2.5e8))
    assert main(["check", str(tmp_path / "s.yaml")]) == 0
    assert "is a unit wrong? [accept: {all: unit}]" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "s.yaml"), "measurements.accept={all: unit}"]) == 0
    assert "is a unit wrong? (accepted)" in capsys.readouterr().out


@pytest.mark.parametrize(("height", "doubted"), [(1.2, False), (0.03, False), (0.02, True), (2e4, True)])
def test_a_drift_ratio_that_no_structure_has_is_doubted(height, doubted):
    # 12 mm over 1.2 m are 1 %, over 0.02 m 60 %; a motion of 12 µm over 20 km is 6e-10.
    small = 1e-3 if height > 100 else 1.0
    found = [*drift_doubts(campaign(record(elongation=small)), height)]
    assert len(found) == doubted
    if found:
        assert found[0].kind == "unit" and found[0].spans and f"height of {height:g} m" in found[0].message


@pytest.mark.whole
def test_init_writes_the_height_by_which_check_judges(tmp_path, capsys):
    write_campaign(campaign(record()), tmp_path)
    assert main(["init", str(tmp_path), "--height", "0.02"]) == 0
    assert load_study(tmp_path / "study.yaml").measurements.height == 0.02
    capsys.readouterr()
    assert main(["check", str(tmp_path / "study.yaml")]) == 0
    assert "is a drift ratio of 0.6 of the height of 0.02 m" in capsys.readouterr().out


def test_a_record_is_compared_with_the_excitation_of_the_study(tmp_path):
    of = campaign(record(), inputs={"a": "mm"}, values=[(12e-3,)])
    write_campaign(of, tmp_path)
    text = (
        "study: x\nmodel: {parameters: {A: {uniform: [1.0e6, 1.0e8]}, beta: {uniform: [20.0, 2000.0]}, gamma: 0.0, n: 1.0}}\n"
        "inputs: {a: {uniform: [1.0, 20.0], unit: mm}}\nexcitation: {imposed: {amplitudes: [a], rate: 0.001}}\n"
        "experiments: {campaign: .}\nobserve: histories\nsteps: [calibrate]\n"
    )
    (tmp_path / "s.yaml").write_text(text)
    assert unit_doubts(Built(load_study(tmp_path / "s.yaml"))) == []
    write_campaign(replace(of, experiments=(replace(of["E0"], inputs={"a": 12e-3 / 25.4}),)), tmp_path / "inch")
    (tmp_path / "inch" / "s.yaml").write_text(text)
    (finding,) = unit_doubts(Built(load_study(tmp_path / "inch" / "s.yaml")))
    assert finding.channel == "elongation" and "are mm and inch mixed?" in finding.message


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured campaigns are not at {DATA}")
@pytest.mark.parametrize("name", sorted(path.parent.name for path in DATA.glob("*/campaign.yaml")))
def test_measured_campaigns_have_no_doubt_of_units(name):
    assert doubts(read_campaign(DATA / name)) == []


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the friction damper is not at {DATA}")
def test_a_factorial_of_a_damper_under_several_tensions_has_no_doubt_of_units():
    folder = DATA / "friction_damper_factorial"
    names = [path.stem for path in sorted((folder / "records").glob("d2_*.csv"))]
    tables = {
        name: np.loadtxt(folder / "records" / f"{name}.csv", delimiter=",", skiprows=1, max_rows=2000) for name in names
    }
    frames = {name: {"time": t[:, 0], "elongation": t[:, 1], "force": t[:, 2]} for name, t in tables.items()}
    channels = {"time": "s", "elongation": "inch", "force": "kip"}
    assert doubts(Campaign.from_frames(records=frames, protocol="displacement", channels=channels)) == []
    wrong = names[-1]
    frames[wrong] = frames[wrong] | {"force": 1000 * frames[wrong]["force"]}
    assert doubts(Campaign.from_frames(records=frames, protocol="displacement", channels=channels)) == [
        (wrong, "force")
    ]
