"""Conjugate pairs: units decide which, those that do not belong together are refused, and labels and units follow the pair."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pint
import pytest
import xarray as xr
from builders.outcomes import Expecting

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.diagnosis import diagnose
from hsed_jax.diagnosis.evidence import Sampled
from hsed_jax.diagnosis.fit_state import FitState, Submodel
from hsed_jax.diagnosis.fits import Model
from hsed_jax.diagnosis.problem import FormColumns
from hsed_jax.measurements import (
    Campaign,
    Channel,
    Experiment,
    Record,
    characteristics,
    check_campaign,
    overview,
    parse_unit,
    read_campaign,
)
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.forms import forms_of
from hsed_jax.physics.laws import LAWS
from hsed_jax.physics.outputs import CHANNELS, QUANTITIES
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE, PAIRS
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.scales import Scales
from hsed_jax.runs.conduct import Asked
from hsed_jax.runs.requests import Expected
from hsed_jax.study.build import Built

LENGTH, ROTATION, STRAIN, SHEAR = PAIRS
NAME = "stiffness_degradation"


def declared(protocol="displacement", quantities=(), **channels):
    """A campaign without experiments, units by channel."""
    made = {name: Channel(name, unit) for name, unit in channels.items()}
    return Campaign("c", protocol, {}, made, {name: Channel(name, unit) for name, unit in dict(quantities).items()})


# --- units decide -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("elongation", "force", "pair", "si"),
    [
        ("mm", "kN", LENGTH, (1e-3, 1e3)),
        ("inch", "kip", LENGTH, (0.0254, 4448.2216152605)),
        ("mrad", "kN*m", ROTATION, (1e-3, 1e3)),
        ("deg", "kip*inch", ROTATION, (np.pi / 180, 112.9848290276167)),
        ("%", "kN m", ROTATION, (1e-2, 1e3)),
        ("1", "MPa", STRAIN, (1.0, 1e6)),
        ("mm/m", "N/mm^2", STRAIN, (1e-3, 1e6)),
        ("%", "ksi", STRAIN, (1e-2, 6894757.293168361)),
        ("rad", "kN", SHEAR, (1.0, 1e3)),
    ],
)
def test_the_units_say_which_pair_it_is_and_are_read_in_si(elongation, force, pair, si):
    campaign = declared(elongation=elongation, force=force)
    assert campaign.pair == pair
    assert (campaign.unit("elongation").to_si(1.0), campaign.unit("force").to_si(1.0)) == pytest.approx(si, rel=1e-12)


def test_quantities_alone_say_it_too_and_what_says_nothing_is_elongation_and_force():
    told = {"peak_force": "kN*m", "peak_elongation": "mrad", "dissipated_energy": "kJ", "residual_elongation": "deg"}
    assert declared("ground_motion", told).pair == ROTATION
    assert declared("ground_motion", {"dissipated_energy": "MJ/m^3"}).pair == STRAIN
    assert (
        declared("ground_motion", {"dissipated_energy": "J"}).pair == LENGTH
    )  # a moment on a rotation would be J, too
    assert declared("ground_motion", time="s", ground_acceleration="g", acceleration_1="g").pair == LENGTH


@pytest.mark.parametrize(
    ("channels", "quantities", "words"),
    [
        ({"elongation": "mm", "force": "MPa"}, {}, ["channels.elongation in 'mm' and channels.force in 'MPa'"]),
        ({"elongation": "mrad", "force": "kN*m"}, {"peak_force": "kN"}, ["channels.force", "quantities.peak_force in 'kN'"]),
        ({"elongation": "%", "force": "MPa", "elongation_rate": "mm/s"}, {}, ["channels.elongation_rate in 'mm/s'"]),
    ],
)  # fmt: skip
def test_units_that_do_not_belong_together_are_refused_with_both_and_what_is_allowed(channels, quantities, words):
    with pytest.raises(hx.UserError) as refused:
        declared(quantities=quantities, **channels)
    for word in [*words, "do not belong together", *map(str, PAIRS)]:
        assert word in str(refused.value)


def test_a_unit_of_no_pair_and_one_of_several_are_refused():
    with pytest.raises(
        hx.UserError, match=r"channels.force: unit 's' does not measure force .*rotation \[rad\] and moment"
    ):
        declared(elongation="mrad", force="s")
    with pytest.raises(hx.UserError, match=r"'rad' may be a rotation or a strain or a shear angle: .*declare force"):
        declared(elongation="rad")


# --- units and words follow ---------------------------------------------------------------------------------------

REGISTRY = pint.UnitRegistry()


def powers(factor) -> list[int]:
    """Powers of force, elongation and time in a factor of scales, from what other units of each change in its value."""

    def value(force=1.0, elongation=1.0, time=1.0):
        return float(factor(Scales(7.0 * force, 3.0 * elongation, 5.0 * elongation / time, 21.0 * force * elongation)))

    found = [np.log2(value(**{name: 2.0}) / value()) for name in ("force", "elongation", "time")]
    assert np.allclose(found, np.round(found))
    return [round(power) for power in found]


@pytest.mark.parametrize("pair", PAIRS, ids=str)
def test_physical_parameters_of_effects_have_the_dimensions_that_their_factor_has(pair):
    basis = [REGISTRY.Quantity(1.0, unit) for unit in (pair.force_unit, pair.elongation_unit, "s")]
    assert (basis[0] * basis[1]).check(REGISTRY.Quantity(1.0, pair.energy_unit).dimensionality)
    checked = 0
    for effect in EFFECTS.values():
        for known in parameters_of(effect).values():
            if known.physical is not None:
                force, elongation, time = (
                    unit**power for unit, power in zip(basis, powers(known.physical.factor), strict=True)
                )
                found = REGISTRY.Quantity(1.0, pair.unit(known.physical.unit))
                assert found.check((force * elongation * time).dimensionality), known.physical
                checked += 1
    assert checked > 15


@pytest.mark.parametrize("pair", PAIRS, ids=str)
def test_every_unit_of_a_channel_quantity_and_law_is_one_that_can_be_declared(pair):
    for name in (*QUANTITIES, *CHANNELS, "energy_at_5s", "velocity_2"):
        unit = pair.output(name).unit
        assert parse_unit(unit).factor == 1, name
    for law in LAWS.values():
        for known in parameters_of(law).values():
            parse_unit(pair.unit(known.unit.replace("^(1-n)", "^2")))


@pytest.mark.parametrize(
    ("si", "rotation", "strain", "shear"),
    [
        ("N/m", "N*m/rad", "Pa", "N/rad"),
        ("1/m", "1/rad", "1", "1/rad"),
        ("m/N", "rad/(N*m)", "1/Pa", "rad/N"),
        ("N*s^2/m^2", "N*m*s^2/rad^2", "Pa*s^2", "N*s^2/rad^2"),
        ("N^(1-n)/m", "N^(1-n)*m^(1-n)/rad", "Pa^(1-n)", "N^(1-n)/rad"),
        ("1/J", "1/J", "m^3/J", "m/J"),
        ("m/s", "rad/s", "1/s", "rad/s"),
        ("s", "s", "s", "s"),
        ("1", "1", "1", "1"),
    ],
)
def test_units_are_translated(si, rotation, strain, shear):
    assert [pair.unit(si) for pair in PAIRS] == [si, rotation, strain, shear]


def test_words_and_symbols_are_translated_and_the_ground_and_the_masses_stay_in_metres():
    assert (
        ROTATION.words("Elongations and forces of a reinforced joint") == "Rotations and moments of a reinforced joint"
    )
    assert STRAIN.words("near zero force, large forces") == "near zero stress, large stresses"
    assert [pair.called("peak_force") for pair in PAIRS] == [
        "peak force",
        "peak moment",
        "peak stress",
        "peak shear force",
    ]
    assert ROTATION.output("peak_elongation").symbol == r"\max|\theta|"
    assert STRAIN.output("peak_force").meaning == "largest restoring stress of the specimen"
    for name in ("ground_acceleration", "displacement_1", "peak_absolute_acceleration", "time"):
        for pair in PAIRS:
            assert pair.output(name) == ELONGATION_AND_FORCE.output(name)


def bare(kind, **fields):
    """A tuple with names that has what is looked at and nothing else."""
    return kind(**{name: fields.get(name) for name in kind._fields})


def test_sizes_of_effects_have_the_units_of_the_pair():
    sample = Sampled(0.0, np.inf, np.asarray([[0.1], [0.5]]), np.asarray([0.5, 0.5]))
    fit = FitState(Submodel(np.arange(1), np.zeros(1)), np.zeros(1), 0)
    forms = {label: FormColumns(form, np.asarray([0]), {}) for label, form in forms_of(EFFECTS[NAME]).items()}
    about = {"catalogue": EFFECTS, "names": (f"{NAME}.delta",), "scales": Scales(energy=10.0), "effects": {NAME: forms}}
    for pair, unit in ((LENGTH, "1/J"), (ROTATION, "1/J"), (STRAIN, "m^3/J"), (SHEAR, "m/J")):
        problem = bare(diagnose.Problem, **about, pair=pair)
        found = diagnose._estimate(problem, NAME, bare(Model, fit=fit, forms={NAME: "linear"}), sample)
        assert found["delta"]["unit"] == "1" and found["eta"]["unit"] == unit
        assert found["eta"]["mean"] == pytest.approx(0.03)
        # Of another driver the amplitude is no number per joule.
        other = diagnose._estimate(problem, NAME, bare(Model, fit=fit, forms={NAME: "linear of path"}), sample)
        assert list(other) == ["delta"]


# --- where only elongation and force make sense -------------------------------------------------------------------

FRAME = {
    "study": "frame",
    "structure": {
        "masses": [8e3],
        "springs": [],
        "specimen": {"between": ["ground", 1]},
        "damping": {"modal": 0.02, "specimen_stiffness": 5e5},
    },
    "model": {"parameters": {"A": {"uniform": [1e5, 1e6]}, "beta": 1.0, "gamma": 0.0}},
}
CHANNELS_OF_A_JOINT = {
    "time": {"unit": "s"},
    "elongation": {"column": "theta", "unit": "mrad"},
    "force": {"column": "M", "unit": "kN*m"},
}


def test_masses_that_are_shaken_have_no_rotations():
    study = load_study(FRAME | {"experiments": {"campaign": "nowhere"}, "steps": ["calibrate"]})
    campaign = declared("ground_motion", time="s", ground_acceleration="g", elongation="mrad", force="kN*m")
    with pytest.raises(
        hx.UserError, match=r"campaign 'c': .*measured in rotation .*only elongation \[m\] and force \[N\]"
    ):
        Built(study, campaign).check()
    laboratory = {"folder": {"channels": CHANNELS_OF_A_JOINT}}
    with pytest.raises(hx.UserError, match=r"experiments.folder: .*measured in rotation \[rad\] and moment"):
        _ = Built(load_study(FRAME | {"experiments": laboratory})).mechanics.units
    wrong = {"folder": {"channels": CHANNELS_OF_A_JOINT | {"elongation": {"unit": "mm", "column": "M"}}}}
    with pytest.raises(hx.UserError, match=r"experiments.folder.channels.elongation in 'mm' and .*do not belong"):
        _ = Built(load_study(FRAME | {"experiments": wrong})).mechanics.pair


def test_what_a_laboratory_declares_is_asked_in_its_pair():
    study = load_study(
        {k: v for k, v in FRAME.items() if k != "structure"}
        | {
            "experiments": {"folder": {"channels": CHANNELS_OF_A_JOINT}},
            "excitation": {"imposed": {"amplitudes": [0.01, "a"], "cycles": 2, "rate": 0.01}},
            "inputs": {"a": {"uniform": [0.02, 0.05], "unit": "m"}},
        }
    )
    built = Built(study)
    assert built.mechanics.pair == ROTATION and built.mechanics.units == {"A": "N*m/rad"}
    asked, expected = Asked("E01", 0, 1, {}, {}), Expected(np.zeros(1), {}, {"peak_force": np.asarray([1e3, 2e3, 3e3])})
    asks = Expecting(built, SimpleNamespace(steps=[]), expected)
    assert "peak_force expected 2000 N*m (1000 to 3000)" in asks.told(asked)


# --- a joint: rotation and moment ---------------------------------------------------------------------------------

A, BETA, NOISE = 5.0e6, 100.0, 0.2e3  # N m/rad, 1/rad (strength 50 kN m), N m


def moment(rotation):
    """Bouc–Wen with γ = 0, n = 1 on monotone steps: z relaxes to ±A/β over the way."""
    z = np.zeros(rotation.size)
    for k, step in enumerate(np.diff(rotation)):
        limit = np.sign(step) * A / BETA
        z[k + 1] = limit + (z[k] - limit) * np.exp(-BETA * abs(step))
    return z


@pytest.fixture(scope="module")
def joint(tmp_path_factory):
    """The folder of a campaign in mrad and kN m, with the loop of a known law."""
    folder = tmp_path_factory.mktemp("joint")
    (folder / "records").mkdir()
    lines = "\n".join(f"  {name}: {{column: {c['column']}, unit: {c['unit']}}}" for name, c in
                      CHANNELS_OF_A_JOINT.items() if "column" in c)  # fmt: skip
    (folder / "campaign.yaml").write_text(
        f"name: a joint\nprotocol: displacement\nchannels:\n  time: {{column: t, unit: s}}\n{lines}\n"
        "quantities:\n  peak_force: {column: Mmax, unit: kN*m}\n"
    )
    rows = ["id,split,Mmax"]
    for number, (split, amplitude) in enumerate((("train", 0.03), ("test", 0.02))):
        time = np.arange(0, 8001) / 2000
        rotation = amplitude * (0.3 + 0.7 * time / 4) * np.sin(2 * np.pi * time)
        measured = moment(rotation)[::20] + NOISE * np.random.default_rng(number).standard_normal(401)
        rows.append(f"E0{number + 1},{split},{np.abs(measured).max() / 1e3:.6g}")
        table = np.stack([time[::20], 1e3 * rotation[::20], measured / 1e3], axis=1)
        np.savetxt(folder / f"records/E0{number + 1}.csv", table, delimiter=",", header="t,theta,M", comments="")
    (folder / "experiments.csv").write_text("\n".join(rows) + "\n")
    return folder


def joint_study(folder, **changes):
    return load_study(
        {
            "study": "joint",
            "model": {
                "parameters": {
                    "A": {"lognormal": [np.log(1.5 * A), 0.7]},
                    "beta": {"lognormal": [np.log(0.7 * BETA), 0.7]},
                    "gamma": 0.0,
                    "n": 1.0,
                }
            },
            "experiments": {"campaign": str(folder)},
            "observe": "histories",
            "steps": ["calibrate", "compare"],
            "calibration": {"sampler": "laplace", "starts": 1},
            **changes,
        }
    )


@pytest.fixture(scope="module")
def run(joint, tmp_path_factory):
    """A run of it, in its folder."""
    output = tmp_path_factory.mktemp("runs") / "joint"
    hx.run(joint_study(joint), output=output)
    return output


@pytest.mark.whole
def test_the_stiffness_of_a_joint_is_found_in_newton_metres_per_radian(run):
    summary = json.loads((run / "summary.json").read_text())
    # Between samples the path is an interpolant, which costs a part in a thousand; the noise as much.
    assert summary["calibration"]["map"]["A"] == pytest.approx(A, rel=0.01)
    assert summary["calibration"]["map"]["beta"] == pytest.approx(BETA, rel=0.01)
    tree = xr.open_datatree(run / "results.nc")
    assert tree["posterior"]["A"].attrs["units"] == "N*m/rad" and tree["posterior"]["beta"].attrs["units"] == "1/rad"
    assert tree["predictions/train/E01"]["force_measured"].attrs["units"] == "N*m"
    tree.close()


@pytest.mark.whole
def test_figures_and_report_of_a_joint_speak_of_moment_and_rotation(run):
    overlay = (run / "figures" / "overlay_E01.svg").read_text()
    for text in ("Moment", "[kN·m]", "Rotation", "[mrad]"):
        assert text in overlay
    cycles = (run / "figures" / "cycles.svg").read_text()
    assert "[kJ]" in cycles and "[kN·m/mrad]" in cycles
    for name in ("overlay_E01", "cycles", "error_table", "residual_coordinates"):
        drawn = run / "figures" / f"{name}.svg"
        assert not drawn.exists() or not {"Force", "Elongation", "[mm]", "[kN]"} & set(drawn.read_text().split(">")), (
            name
        )
    page = (run / "report.html").read_text()
    assert "driven by the rotation that was imposed" in page
    assert "Moment [kN·m]" in page and "Rotation [mrad]" in page and "rotation rate [" in page
    for wrong in ("Force [", "Elongation [", "elongation [", "elongation rate ["):
        assert wrong not in page


def test_the_check_says_what_was_measured_in_its_units(joint, tmp_path, capsys):
    path = tmp_path / "study.yaml"
    assert main(["init", str(joint), "--output", str(path)]) == 0
    text = path.read_text()
    assert "initial stiffness [N*m/rad]" in text and "stiffness over strength [1/rad]" in text
    assert "the rotation was imposed" in text and "largest moment" in text and "largest rotation" in text
    assert "force" not in text and "elongation" not in text
    assert main(["check", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "kN*m/mrad" in shown and "kN*m mrad" in shown and "force [kN*m]" in shown
    found = characteristics(read_campaign(joint))
    assert found.stiffness == pytest.approx(A, rel=0.3)


def test_faults_are_told_in_the_units_of_the_pair(joint):
    campaign = read_campaign(joint)
    record = campaign["E01"].record
    backward = Record(record.time, {**record.channels, "force": -record["force"]})
    (sign,) = [f for f in check_campaign(replace(campaign, experiments=(Experiment("E", record=backward),)))
               if f.kind == "sign"]  # fmt: skip
    assert "the work of moment on rotation is -" in sign.message
    strains = Campaign(
        "s", "displacement", {}, {n: Channel(n, u) for n, u in {"elongation": "-", "force": "Pa"}.items()}
    )
    wild = Record(np.arange(401.0), {"elongation": record["elongation"], "force": record["force"] / 1e3})
    messages = [f.message for f in check_campaign(replace(strains, experiments=(Experiment("E", record=wild),)))]
    assert any("Pa, plausible is 1000 to 1e+11 Pa: is the unit right?" in message for message in messages)


def test_a_campaign_keeps_its_pair_in_memory_and_is_not_compared_in_another(joint):
    campaign = read_campaign(joint)
    tree = campaign.to_xarray()
    assert Campaign.from_xarray(tree).pair == ROTATION
    assert tree["records/E01"]["force"].attrs["units"] == "N*m" and tree["peak_force"].attrs["units"] == "N*m"
    built = Built(joint_study(joint))
    metres = {n: Channel(n, u) for n, u in {"time": "s", "elongation": "mm", "force": "kN"}.items()}
    with pytest.raises(hx.UserError, match=r"measured in elongation \[m\] and force \[N\]; the study is of rotation"):
        built.inference.data(Campaign("other", "displacement", {}, metres), ())


# --- measured coupons: strain and stress --------------------------------------------------------------------------


@pytest.mark.whole
def test_steel_coupons_are_strain_and_stress(shared):
    source = read_campaign(shared / "data" / "steel_coupons")
    bar = ("A64",)
    records = {id: source[id].record.channels for id in bar}  # as if in m and N: the numbers of the files
    campaign = Campaign.from_frames(
        {"id": list(bar)},
        {id: {"strain": r["elongation"], "stress": r["force"]} for id, r in records.items()},
        name="steel coupons",
        protocol="displacement",
        channels={"elongation": Channel("elongation", "1", "strain"), "force": Channel("force", "MPa", "stress")},
    )
    assert campaign.pair == STRAIN and "force [MPa]" in str(overview(campaign))
    study = joint_study(
        shared / "data" / "steel_coupons",
        study="coupons",
        measurements={"samples": 100},
        model={
            "spring": "menegotto_pinto",
            "parameters": {
                "k": {"lognormal": [np.log(2e11), 0.5]},
                "F_y": {"lognormal": [np.log(4.5e8), 0.3]},
                "b": 0.01,
            },
        },
    )
    calibration = hx.calibrate(study, campaign)
    assert calibration.fit.units["k"] == "Pa" and calibration.fit.units["F_y"] == "Pa"
    assert 1.6e11 < calibration.map["k"] < 2.3e11  # steel
    assert (
        3.5e8 < calibration.map["F_y"] < 8e8
    )  # of a law without a plateau; the coupons yield at 450 MPa and end at 650
    (_, _, *panels) = axes = hx.plot.histories(calibration, "A64")
    labels = {axes[0].get_ylabel().replace("\n", " "), axes[1].get_xlabel(), axes[1].get_ylabel()}
    assert labels == {r"Stress $\sigma$ [MPa]", r"Strain $\varepsilon$ [–]"} and panels == []
    energy, stiffness, backbone = hx.plot.cycles(calibration)[:3]
    assert "MJ/m$^{3}$" in energy.get_ylabel() and "[GPa]" in stiffness.get_ylabel()
    assert backbone.get_xlabel().startswith("Strain") and backbone.get_ylabel().startswith("Stress")
    sentences = " ".join(hx.locate(calibration).sentences)
    assert not {"force", "elongations", "elongation"} & set(sentences.replace(";", " ").split())
