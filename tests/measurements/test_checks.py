"""Faults put into clean data are found, by experiment and time; clean data give no finding."""

from dataclasses import replace

import numpy as np
import pytest
from builders.places import DATA
from builders.records import SIGMA, as_record, clean, in_mm, loop
from scipy.signal import lfilter

from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.measurements import (
    Campaign,
    Channel,
    Experiment,
    Finding,
    Noise,
    Record,
    check_campaign,
    noise_estimate,
    overview,
    read_campaign,
    stop_at_errors,
    write_campaign,
)
from hsed_jax.measurements.noise import record_noise


def campaign_of(data: dict[str, np.ndarray], noise: bool = True, **quantities: float) -> Campaign:
    units = {"time": "s", "ground_acceleration": "g", "elongation": "mm", "force": "kN"}
    channels = {
        name: Channel(name, unit, noise=Noise(absolute=SIGMA[name]) if noise and name in SIGMA else None)
        for name, unit in units.items()
    }
    record = Record(data["time"], {name: values for name, values in data.items() if name != "time"})
    declared = {"peak_force": Channel("peak_force", "kN"), "peak_elongation": Channel("peak_elongation", "mm")}
    experiment = Experiment("E01", record=record, quantities=quantities)
    return Campaign("synthetic", "ground_motion", {}, channels, declared, (experiment,))


def findings(data: dict[str, np.ndarray], **quantities: float) -> list[Finding]:
    return check_campaign(campaign_of(data, **quantities))


@pytest.mark.parametrize("seed", range(10))
def test_clean_data_give_no_finding(seed):
    assert findings(clean(seed)) == []


def test_clean_data_without_noise_give_no_finding():
    assert check_campaign(campaign_of(clean(noise=0.0), noise=False)) == []


def test_clean_data_rounded_to_a_few_digits_give_no_finding():
    data = clean()
    rounded = {"time": data["time"]} | {k: np.round(v, 4 - int(np.log10(np.abs(v).max()))) for k, v in data.items()}
    assert check_campaign(campaign_of(rounded, noise=False)) == []


def test_uneven_sampling_is_no_fault():
    keep = np.sort(np.random.default_rng(1).choice(2000, 1200, replace=False))
    assert findings({k: v[keep] for k, v in clean().items()}) == []


def fault(channel: str, change):
    def inject(data):
        values = data[channel].copy()
        result = change(values)
        return data | {channel: values if result is None else result}

    return inject


def put(where, value):
    def change(values):
        values[where] = value

    return change


FAULTS = {
    "nan": (fault("force", put(slice(700, 703), np.nan)), "error", "force", 3.5, "3 of 2000 samples"),
    "no time": (fault("time", put(5, np.nan)), "error", "time", None, "sample 6 has no time"),
    "backward time": (fault("time", put(1000, 4.0)), "error", "time", 4.0, "backward at sample 1001"),
    "duplicate time": (fault("time", put(1000, 4.995)), "error", "time", 4.995, "repeated at sample 1001"),
    "gap": (fault("time", lambda t: t + 0.3 * (t >= 5)), "doubt", "time", 4.995, "1 gaps"),
    "clipped": (fault("force", lambda f: np.clip(f, -6e3, 6e3)), "doubt", "force", None, "clipped"),
    "clipped above": (fault("elongation", lambda u: np.minimum(u, 0.02)), "doubt", "elongation", None, "clipped"),
    "stuck": (fault("force", put(slice(700, 800), 123.0)), "doubt", "force", 3.5, "100 samples"),
    "dead": (fault("force", put(slice(None), 3.0)), "error", "force", None, "constant"),
    "still": (fault("ground_acceleration", put(slice(None), 0.0)), "doubt", "ground_acceleration", None, "constant"),
    "millimetres": (fault("elongation", lambda u: 1e4 * u), "doubt", "elongation", None, "is the unit right"),
    "g of g": (fault("ground_acceleration", lambda a: 9.81**2 * a), "doubt", "ground_acceleration", None, "unit"),
    "sign of force": (fault("force", lambda f: -f), "doubt", "force", None, "sign"),
    "sign of elongation": (fault("elongation", lambda u: -u), "doubt", "force", None, "sign"),
    "noisier": (
        fault("force", lambda f: f + 500 * np.random.default_rng(9).normal(size=f.size)),
        "doubt", "force", None, "declared noise is 0.05 kN",
    ),
    "smoother": (
        fault("force", lambda f: np.convolve(f, np.hanning(41) / 20, "same")),
        "doubt", "force", None, "declared noise is 0.05 kN",
    ),
    "offset of force": (fault("force", lambda f: f + 800), "doubt", "force", 0.0, "before the motion"),
    "offset of elongation": (fault("elongation", lambda u: u + 2e-3), "doubt", "elongation", 0.0, "before the motion"),
    "offset of the ground": (
        fault("ground_acceleration", lambda a: a + 0.2), "doubt", "ground_acceleration", 0.0, "before the motion",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTS)
def test_an_injected_fault_is_found(case):
    inject, level, channel, time, words = FAULTS[case]
    found = findings(inject(clean()))
    matching = [f for f in found if f.level == level and f.channel == channel and words in f.message]
    assert len(matching) == 1, [str(f) for f in found]
    assert matching[0].experiment == "E01"
    if time is not None:
        assert matching[0].time == pytest.approx(time)
    assert {f.channel for f in found} == {channel}
    assert str(matching[0]).startswith(f"{level}: E01, {channel}")


def rows_of(data: dict[str, np.ndarray]) -> Campaign:
    """A component test without time."""
    return Campaign.from_frames(
        records={"E01": {name: data[name] for name in ("elongation", "force")}},
        protocol="displacement",
        channels={"elongation": "m", "force": "N"},
    )


def test_missing_rows_of_a_record_without_time_are_a_jump_of_the_elongation():
    data = {name: values[200:] for name, values in clean().items()}
    assert check_campaign(rows_of(data)) == []
    (found,) = check_campaign(rows_of({name: np.delete(values, slice(900, 960)) for name, values in data.items()}))
    assert (found.kind, found.channel, found.time) == ("jump", "elongation", 900)
    assert "row 900" in str(found) and " s" not in str(found).replace(" steps", "").replace("it jumps", "")


def test_messages_about_rows_do_not_speak_of_seconds():
    data = clean()
    data["force"][700] = np.nan
    (found,) = check_campaign(rows_of(data))
    assert str(found) == "error: E01, force, row 700: 1 of 2000 samples are not numbers, the first is sample 701"
    with pytest.raises(UserError, match=r"from 0 to 9999 does not lie in the record; .* between 0 and 1999$"):
        Experiment("E01", record=rows_of(clean())["E01"].record, window=(0, 9999))


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_first_small_loading_is_no_offset_before_the_motion(noise):
    """Small cycles of less than a hundredth of the largest are a motion, though a slow one."""
    data = clean(noise=noise)
    small = 2e-4 * np.sin(np.linspace(0, np.pi, 300))
    motion = np.concatenate([np.zeros(0), small, data["elongation"][200:]])
    force = np.concatenate([1e6 * small, data["force"][200:]])
    assert check_campaign(rows_of({"elongation": motion, "force": force})) == []


def test_a_suspected_sign_flip_stops_until_it_is_accepted():
    flipped = campaign_of({**clean(), "force": -clean()["force"]})
    with pytest.raises(UserError, match=r"is a sign flipped\?.*accept: {E01: sign}}"):
        stop_at_errors(flipped)
    stop_at_errors(flipped, {("E01", "sign")})
    with pytest.raises(UserError, match="sign flipped"):
        stop_at_errors(flipped, {("E01", "offset"), ("E02", "sign")})


def test_the_overview_shows_data_in_the_units_that_they_were_declared_in():
    table = overview(campaign_of(clean(noise=0), peak_force=1e4))
    row = dict(zip(table.heads, table.rows[0], strict=True))
    loop = clean(noise=0)
    assert row["force [kN]"] == f"{np.abs(loop['force']).max() / 1e3:.4g}" and row["elongation [mm]"].startswith("29.")
    assert float(row["initial stiffness [kN/mm]"]) == pytest.approx(1.0, rel=0.2)
    energy = np.trapezoid(loop["force"], loop["elongation"])  # 1 J is 1 kN mm
    assert float(row["dissipated energy [kN mm]"]) == pytest.approx(energy, rel=1e-3)
    assert row["peak_force [kN]"] == "10" and row["samples"] == "2000"


def test_the_overview_of_a_window_is_of_the_window():
    whole = campaign_of(clean(noise=0))
    (experiment,) = whole
    last = float(experiment.record.time[-1])
    parts = [replace(experiment, id=id, window=w) for id, w in (("early", (0.0, last / 2)), ("late", (last / 2, last)))]
    table = overview(replace(whole, experiments=(experiment, *parts)))
    first, early, late = (dict(zip(table.heads, row, strict=True)) for row in table.rows)
    assert first["samples"] == "2000" and {early["samples"], late["samples"]} <= {"1000", "1001"}
    energies = [float(row["dissipated energy [kN mm]"]) for row in (first, early, late)]
    assert late["initial stiffness [kN/mm]"] == "–"  # it begins in the middle of a loop
    assert float(early["initial stiffness [kN/mm]"]) == pytest.approx(1.0, rel=0.2)
    assert energies[1] != energies[2] and energies[0] == pytest.approx(energies[1] + energies[2], rel=0.02)


def test_quantities_out_of_range_are_doubted():
    found = findings(clean(), peak_force=5e3, peak_elongation=30.0)
    assert [(f.level, f.channel) for f in found] == [("doubt", "peak_elongation")]


def test_only_what_is_used_is_checked():
    data = clean()
    data["force"][5] = np.nan
    campaign = campaign_of(data)
    failed = Experiment("E01", record=campaign["E01"].record, status="failed")
    assert check_campaign(campaign) and not check_campaign(campaign.update(failed))


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("sigma", [1e-6, 1e-3, 5.0])
def test_noise_estimate(sigma, uneven):
    rng = np.random.default_rng(3)
    time = np.sort(rng.uniform(0, 20, 4000)) if uneven else np.linspace(0, 20, 4000)
    noise = sigma * rng.normal(size=4000)
    assert noise_estimate(time, noise) == pytest.approx(sigma, rel=0.08)
    signal = 1e3 * sigma * np.sin(time) + noise
    signal[2000:] += 100 * sigma  # a jump does not matter
    assert noise_estimate(time, signal) == pytest.approx(sigma, rel=0.08)
    assert noise_estimate(time, time**2) < 1e-9
    assert np.isnan(noise_estimate(time[:7], noise[:7]))


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("samples", [100, 700])
def test_the_largest_noise_of_a_record_is_not_exceeded_by_autocorrelated_noise(rho, samples):
    random, time = np.random.default_rng(5), np.arange(samples) * 0.01
    changes = np.sqrt(1 - rho**2) * random.standard_normal((200, samples + 100))
    noises = lfilter([1.0], [1.0, -rho], changes, axis=1)[:, 100:]
    found = [record_noise(time, np.sin(2 * time) + noise) for noise in noises]
    assert np.mean([noise.largest >= 1.0 for noise in found]) > 0.9
    if rho == 0:
        # If enough samples show that the noise is white, it is hardly larger than its estimate.
        assert np.median([noise.largest for noise in found]) < (1.6 if samples == 700 else 6.0)
    else:
        assert np.median([noise.size for noise in found]) < 0.7


def test_the_largest_noise_of_a_short_or_constant_record():
    time = np.arange(12.0)
    short = record_noise(time, np.random.default_rng(0).standard_normal(12))
    assert short.largest > 4 * short.size > 0  # six samples say nothing about the correlation
    assert max(record_noise(time, np.ones(12))) < 1e-12
    assert np.isnan(record_noise(time[:5], np.ones(5))).all()


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured campaigns are not at {DATA}")
@pytest.mark.parametrize("name", ["friction_damper", "rc_column", "steel_damper", "timber_connection"])
def test_measured_campaigns_have_no_errors(name):
    found = check_campaign(read_campaign(DATA / name))
    assert [str(f) for f in found if f.level == "error"] == []
    # True ones: friction holds the damper's force before the earthquakes; two are tested beyond what is fitted.
    expected = {
        "friction_damper": {("kocaeli", "force", "offset"), ("imperial_valley", "force", "offset")},
        "timber_connection": {("later_cycles", "elongation", "beyond")},
        "steel_damper": {("later_cycles", "elongation", "beyond")},
    }
    assert {(f.experiment, f.channel, f.kind) for f in found} == expected.get(name, set())


# --- what force and elongation say together --------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("rate", [None, 100.0])
def test_a_clean_loop_gives_no_finding(noise, rate):
    assert check_campaign(in_mm(loop(noise=noise), rate)) == []


ELASTIC = (1, 1, 2, 2, 2, 2, 12, 12)


def shifted(data, samples):
    """The force comes later by some samples."""
    u, f = data["elongation"], data["force"]
    cut = (u[samples:], f[:-samples]) if samples > 0 else (u[:samples], f[-samples:])
    return dict(zip(("elongation", "force"), cut, strict=True))


@pytest.mark.parametrize(("samples", "words"), [(4, "come late? A lag of about"), (-4, "come early?")])
def test_a_force_that_is_not_simultaneous_is_doubted_without_a_time(samples, words):
    (found,) = [f for f in check_campaign(in_mm(shifted(loop(ELASTIC, noise=0.1), samples))) if f.kind != "offset"]
    assert found.kind == "timing" and found.channel == "force" and words in found.message


def test_a_lag_is_told_in_seconds_where_there_is_a_time_and_a_viscous_lead_is_no_fault():
    (found,) = [f for f in check_campaign(in_mm(shifted(loop(ELASTIC, noise=0.1), 4), 100.0)) if f.kind != "offset"]
    assert found.kind == "timing" and " s would explain it" in found.message
    assert [f for f in check_campaign(in_mm(shifted(loop(ELASTIC, noise=0.1), -4), 100.0)) if f.kind != "offset"] == []


def test_a_specimen_that_softens_has_no_early_force():
    u = loop()["elongation"]
    yielding = np.zeros(u.size)  # elastic-perfectly plastic, less a share of its stiffness: P-Delta
    for i, step in enumerate(np.diff(u)):
        yielding[i + 1] = np.clip(yielding[i] + 1e7 * step, -2e4, 2e4)
    softened = in_mm({"elongation": u, "force": yielding - 0.1 * 1e7 * u})
    assert [f for f in check_campaign(softened) if f.kind == "timing"] == []


def test_negative_work_that_a_lag_explains_is_told_so():
    u = loop()["elongation"]
    elastic = {"elongation": u, "force": 1e7 * u}
    (found,) = [f for f in check_campaign(in_mm(shifted(elastic, 5), 100.0)) if f.kind == "sign"]
    assert "or the force comes late? A lag of 0.05 s would explain it" in found.message and " J: " in found.message
    (found,) = [f for f in check_campaign(in_mm({**loop(), "force": -loop()["force"]})) if f.kind == "sign"]
    assert found.message.endswith("is a sign flipped?")


DOUBTS = {
    "jump": (lambda d: {k: np.delete(v, slice(301, 315)) for k, v in d.items()}, "jump", "elongation", 300),
    "slip": (lambda d: d | {"elongation": np.where(np.arange(480) == 433, d["elongation"] - 3e-3, d["elongation"])},
             "slip", "elongation", 432),
    "drift of the force": (lambda d: d | {"force": d["force"] + np.linspace(0, 6e3, 480)}, "drift", "force", None),
    "drift of the elongation": (lambda d: d | {"elongation": d["elongation"] + np.linspace(0, 2e-3, 480)},
                                "drift", "elongation", None),
    "offset": (lambda d: d | {"elongation": d["elongation"] + 1e-3}, "offset", "elongation", 0),
    "unit": (lambda d: d | {"elongation": np.where(np.arange(480) < 243, 1e-3, 1) * d["elongation"]},
             "unit", "elongation", 243),
}  # fmt: skip


@pytest.mark.parametrize("case", DOUBTS)
@pytest.mark.parametrize("rate", [None, 100.0])
def test_a_fault_of_a_loop_is_doubted_with_its_row(case, rate):
    inject, kind, channel, row = DOUBTS[case]
    found = check_campaign(in_mm(inject(loop()), rate))
    matching = [f for f in found if f.kind == kind]
    assert len(matching) == 1, [str(f) for f in found]
    assert matching[0].channel == channel and matching[0].setting == f"accept: {{E01: {kind}}}"
    if row is not None:
        assert matching[0].time == pytest.approx(row / (rate or 1), abs=2.1 / (rate or 1))
    assert (" kN" if channel == "force" else " mm") in matching[0].message or kind == "unit"


def test_a_hold_in_which_the_force_relaxes_is_doubted():
    data = loop()
    u, f = (np.insert(data[name], 375, np.full(40, data[name][375])) for name in ("elongation", "force"))
    f[375:415] *= np.linspace(1, 0.7, 40)
    found = {finding.kind: finding for finding in check_campaign(in_mm({"elongation": u, "force": f}))}
    assert found["hold"].time == pytest.approx(375, abs=2) and set(found) <= {"hold", "clipped"}


@pytest.mark.parametrize("path", ["monotonic", "through zero", "back to zero"])
def test_one_loading_branch_has_no_hysteresis(path):
    way = np.linspace(0, 0.02, 40)
    u = {
        "monotonic": way,
        "through zero": np.linspace(-0.02, 0.02, 40),
        "back to zero": np.concatenate([-way[::-1], way]),
    }[path]
    *others, found = check_campaign(in_mm({"elongation": u, "force": 1e4 * np.tanh(200 * u)}))
    # Two of them begin loaded.
    assert [f.kind for f in others] == ["offset"] * int(u[0] < 0)
    assert found.kind == "monotonic" and "no hysteresis to identify" in found.message


def test_a_diagnosis_of_one_loading_branch_is_refused_until_it_is_accepted():
    u = np.linspace(0, 0.02, 40)
    branch = in_mm({"elongation": u, "force": 1e4 * np.tanh(200 * u)})
    stop_at_errors(branch)
    stop_at_errors(branch, {("E01", "monotonic")}, needs_loops=True)
    with pytest.raises(UserError, match=r"one loading branch.*\[calibrate, compare\].*accept: \{E01: monotonic\}"):
        stop_at_errors(branch, needs_loops=True)
    stop_at_errors(in_mm(loop()), needs_loops=True)


def test_load_and_unload_is_a_loop():
    u = np.concatenate([np.linspace(0, 0.02, 40), np.linspace(0.02, 0.01, 30)])
    assert check_campaign(in_mm({"elongation": u, "force": 1e6 * (u - 0.3 * np.maximum.accumulate(u))})) == []


# --- what experiments say of one another -----------------------------------------------------------------------------


def two(first: Experiment, second: Experiment, inputs=None) -> list[Finding]:
    channels = {"elongation": Channel("elongation", "mm"), "force": Channel("force", "kN")}
    return check_campaign(Campaign("x", "displacement", inputs or {}, channels, experiments=(first, second)))


def test_samples_that_are_there_twice_are_doubted():
    record, other = as_record(loop(noise=1.0)), as_record(loop(noise=1.0, seed=1))
    assert two(Experiment("E01", record=record), Experiment("E02", record=other)) == []
    (found,) = two(Experiment("E01", record=record), Experiment("E02", record=record))
    assert (found.experiment, found.kind) == ("E02", "copy") and "480 samples are those of E01" in found.message
    half = Record(record.time[:300], {name: values[180:] for name, values in record.channels.items()})
    (found,) = two(Experiment("E01", record=record), Experiment("E02", record=half))
    assert found.kind == "copy"
    (found,) = two(
        Experiment("E01", {"v": 1.0}, record=record), Experiment("E02", {"v": 2.0}, record=record), {"v": "mm/s"}
    )
    assert found.kind == "copy" and "one record with two inputs" in found.message


def test_windows_that_overlap_are_doubted_and_those_that_meet_are_not():
    record = as_record(loop(cycles=(2, 2, 4, 4, 4, 4, 4, 4), noise=1.0))
    fitted = Experiment("E01", record=record, window=(0, 240))
    assert two(fitted, Experiment("E02", record=record, window=(240, 479), split="test")) == []
    (found,) = two(fitted, Experiment("E02", record=record, window=(200, 479), split="test"))
    assert (found.kind, found.experiment) == ("overlap", "E02") and "41 samples" in found.message


def test_a_test_beyond_every_fitted_amplitude_is_doubted():
    small, large = as_record(loop(cycles=(2, 4, 4), noise=1.0)), as_record(loop(noise=1.0, seed=1))
    (found,) = two(Experiment("E01", record=small), Experiment("E02", record=large, split="test"))
    assert found.kind == "beyond" and "reaches 12 mm, the fitted experiments reach 4" in found.message


@pytest.mark.parametrize("samples", [2, 7])
def test_a_record_of_a_few_samples_is_no_history(samples):
    time = np.arange(float(samples))
    record = Record(time, {"elongation": 0.001 * np.sin(time), "force": 2000 * np.sin(time)})
    channels = {name: Channel(name, unit) for name, unit in (("elongation", "m"), ("force", "N"))}
    campaign = Campaign("x", "displacement", channels=channels, experiments=(Experiment("E01", record=record),))
    with pytest.raises(UserError, match=f"the record has {samples} samples; a history that is fitted has 8 at least"):
        stop_at_errors(campaign)


@pytest.mark.whole
def test_fewer_samples_than_parameters_are_one_clear_message(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("hsed_jax.measurements.checks.SAMPLES", 2)
    record = Record(np.arange(2.0), {"elongation": np.array([0, 0.001]), "force": np.array([0, 2000.0])})
    channels = {name: Channel(name, unit) for name, unit in (("elongation", "mm"), ("force", "kN"))}
    write_campaign(
        Campaign("x", "displacement", channels=channels, experiments=(Experiment("E01", record=record),)), tmp_path
    )
    assert main(["init", str(tmp_path)]) == 0
    assert main(["run", str(tmp_path / "study.yaml"), "--output", str(tmp_path / "run"), "steps=[calibrate]"]) == 2
    assert "has no curvature at its maximum" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["check"], ["run", "--output", "run"], ["sweep", "--set", "seed=1,2", "--output", "sweep"]]
)
@pytest.mark.parametrize("channel", ["t", "u", "F"])
def test_a_missing_sample_is_an_error_of_the_data_in_every_command(tmp_path, monkeypatch, capsys, words, channel):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "records").mkdir()
    columns = "time: {column: t, unit: s}, elongation: {column: u, unit: mm}, force: {column: F, unit: kN}"
    (tmp_path / "campaign.yaml").write_text(f"name: x\nprotocol: displacement\nchannels: {{{columns}}}\n")
    (tmp_path / "experiments.csv").write_text("id\nE01\n")
    rows = [{"t": k / 10, "u": np.sin(k / 10), "F": np.tanh(np.sin(k / 10))} for k in range(60)]
    rows[30][channel] = np.nan
    lines = ["t,u,F", *(",".join(str(row[name]) for name in row) for row in rows)]
    (tmp_path / "records" / "E01.csv").write_text("\n".join(lines))
    (tmp_path / "study.yaml").write_text(
        "study: x\nmodel: {parameters: {A: {uniform: [1.0e5, 1.0e7]}, beta: {uniform: [20.0, 2000.0]}, gamma: 0.0, n: 1.0}}\n"
        "experiments: {campaign: .}\nobserve: histories\nsteps: [calibrate]\n"
    )
    assert main([words[0], "study.yaml", *words[1:]]) == 2
    said = capsys.readouterr()
    assert "E01, " in said.err + said.out and "Traceback" not in said.err
