"""Loading protocols by name: against the published tables, to the imposed elongation, the study and the command line."""

import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from builders.places import ROOT

import hsed_jax as hx
from hsed_jax.errors import UserError
from hsed_jax.measurements.cycles import cycles_of as counted
from hsed_jax.physics.excitations.imposed import CyclicElongation
from hsed_jax.physics.protocols import PROTOCOLS, protocol, protocol_history
from hsed_jax.physics.timeline import Timeline, times
from hsed_jax.reporting.protocols import entry, listing
from hsed_jax.study.build import Built

# (amplitude, full cycles) in order, as the documents print them; the trailing cycles of CUREE to three decimals.
PUBLISHED = {
    "curee": [(0.05, 6), (0.075, 1), (0.056, 6), (0.1, 1), (0.075, 6), (0.2, 1), (0.15, 3), (0.3, 1), (0.225, 3),
              (0.4, 1), (0.3, 2), (0.7, 1), (0.525, 2), (1.0, 1), (0.75, 2)],
    "iso_16670": [(0.0125, 1), (0.025, 1), (0.05, 1), (0.075, 1), (0.1, 1), (0.2, 3), (0.4, 3), (0.6, 3), (0.8, 3),
                  (1.0, 3), (1.2, 3)],
    "fema_461": [(0.048, 2), (0.068, 2), (0.095, 2), (0.133, 2), (0.186, 2), (0.26, 2), (0.364, 2), (0.51, 2),
                 (0.714, 2), (1.0, 2)],
    "aci_374": [(0.002, 3), (0.0025, 3), (0.0035, 3), (0.005, 3), (0.0075, 3), (0.01, 3), (0.014, 3), (0.0175, 3),
                (0.022, 3), (0.0275, 3), (0.035, 3)],
    "aisc_341": [(0.00375, 6), (0.005, 6), (0.0075, 6), (0.01, 4), (0.015, 2), (0.02, 2), (0.03, 2), (0.04, 2)],
    "sac": [(0.00375, 6), (0.005, 6), (0.0075, 6), (0.01, 4), (0.015, 2), (0.02, 2), (0.03, 2)],
    "monotonic": [(1.0, 0.25)],
}  # fmt: skip
CYCLES = {"curee": 37, "iso_16670": 23, "atc_24": 21, "fema_461": 20, "aci_374": 33, "aisc_341": 30, "sac": 28}
NEXT = {"curee": [(1.5, 1), (1.125, 2)], "iso_16670": [(1.4, 3)], "atc_24": [(7.0, 2)], "fema_461": [(1.3, 2)],
        "aisc_341": [(0.05, 2)], "sac": [(0.04, 2)]}  # fmt: skip

STUDY = """
study: planned
excitation:
  imposed: {protocol: curee, reference: a, rate: 0.02}
inputs: {a: {uniform: [20.0, 60.0], unit: mm}}
model: {spring: bilinear, parameters: {k: {uniform: [2.0e6, 9.0e6]}, F_y: {uniform: [2.0e4, 6.0e4]}}}
experiments: {virtual: {parameters: {k: 5.0e6, F_y: 4.0e4}, noise: {relative: 1.0e-3}}}
observe: histories
error: {relative: 1.0e-3}
steps: [calibrate]
calibration: {sampler: laplace, starts: 1}
"""


def told(levels):
    return [(level.amplitude, level.quarters / 4) for level in levels]


def matches(found, wanted):
    assert [cycles for _, cycles in found] == [cycles for _, cycles in wanted]
    for (amplitude, _), (published, _) in zip(found, wanted, strict=True):
        # Half of the last digit that is printed.
        assert amplitude == pytest.approx(published, abs=5e-4 if published == 0.056 else 1e-12)


@pytest.mark.parametrize("name", PUBLISHED)
def test_amplitudes_and_cycles_are_the_published_ones(name):
    matches(told(protocol(name).levels()), PUBLISHED[name])


def test_the_sequence_of_atc_24_meets_its_guidelines():
    steps = protocol("atc_24").table
    below = [step for step in steps if step.amplitude < 1]
    assert sum(step.cycles for step in below) >= 6
    assert [tuple(step)[:2] for step in steps[len(below) :]] == [(1, 3), (2, 3), (3, 3), (4, 2), (5, 2), (6, 2)]


def test_the_sequences_of_aci_374_and_fema_461_meet_the_rules_of_their_documents():
    drifts = np.array([step.amplitude for step in protocol("aci_374").table])
    ratios = drifts[1:] / drifts[:-1]
    assert np.all((ratios > 1.25 - 1e-9) & (ratios < 1.5 + 1e-9)) and drifts[-1] >= 0.035
    amplitudes = np.array([step.amplitude for step in protocol("fema_461").table])
    np.testing.assert_allclose(amplitudes[::-1], 1.4 ** -np.arange(10.0), atol=5.1e-4)


def test_every_protocol_is_tested_against_a_table_and_has_its_count_of_cycles():
    assert {*PUBLISHED, "atc_24"} == set(PROTOCOLS)
    for name, count in CYCLES.items():
        assert sum(level.quarters for level in protocol(name).levels()) == 4 * count


@pytest.mark.parametrize("name", NEXT)
def test_a_protocol_goes_on_by_its_increment_and_may_be_cut_short(name):
    known = protocol(name)
    size = len(known.table)
    matches(told(known.levels(size + 1))[len(known.levels()) :], NEXT[name])
    assert known.steps(2) == known.table[:2]


@pytest.mark.parametrize("name", ["curee", "fema_461"])
def test_the_history_has_the_cycles_of_the_table_and_the_rate(name):
    reference, rate = 0.04, 0.02
    time, u = protocol_history(name, reference, rate, points=40)
    assert u[0] == 0 and len(u) == 40 * CYCLES[name] + 1
    peaks = u[1:].reshape(-1, 40).max(axis=1)
    wanted = np.repeat(*map(np.array, zip(*PUBLISHED[name], strict=True)))
    np.testing.assert_allclose(peaks, reference * wanted, atol=reference * 5e-4)
    np.testing.assert_allclose(u[1:].reshape(-1, 40).min(axis=1), -peaks, rtol=1e-12)
    slopes = np.abs(np.diff(u) / np.diff(time))
    assert slopes.max() == pytest.approx(rate, rel=2e-2) and slopes.max() <= rate
    assert time[-1] == pytest.approx(2 * np.pi * peaks.sum() / rate)


def test_the_counting_of_cycles_finds_those_of_the_protocol():
    _, u = protocol_history("aisc_341", 3.0, 0.01)
    found = counted(5e6 * u, u)
    assert len(found) == CYCLES["aisc_341"]


@pytest.mark.parametrize("name", ["curee", "monotonic"])
def test_what_a_specimen_feels_is_the_history_of_the_protocol(name):
    reference, rate, points = 0.04, 0.02, 8
    imposed = CyclicElongation(None, rate, protocol=protocol(name), reference=reference)
    line = Timeline(None, points // 4 * imposed.branches)
    lengths = imposed.step_length(line)
    time, u = protocol_history(name, reference, rate, points=points)
    at = np.asarray(times(lengths, 1, line.samples))
    np.testing.assert_allclose(at, time, rtol=1e-12, atol=1e-12)
    samples = imposed.forcing(lengths, line.steps).samples
    np.testing.assert_allclose(np.asarray(samples.elongation)[::2], u, atol=1e-12)
    direct = jax.vmap(imposed.sample)(jnp.asarray(time[:-1]))
    np.testing.assert_allclose(direct.elongation, u[:-1], atol=1e-11)
    assert float(imposed.duration) == pytest.approx(time[-1])
    assert float(imposed.reach) == pytest.approx(np.abs(u).max() * np.pi / 2)


def study(**imposed):
    content = yaml.safe_load(STUDY)
    entry = {**content["excitation"]["imposed"], **imposed}
    content["excitation"]["imposed"] = {name: value for name, value in entry.items() if value is not None}
    return hx.load_study(content)


def test_the_reference_is_an_input_of_the_experiment():
    for size in (30.0, 55.0):
        found = hx.simulate(study(), {"a": size}, {"k": 5e6, "F_y": 4e4}, ("elongation",))
        assert np.abs(found.channels["elongation"]).max() == pytest.approx(1e-3 * size, rel=1e-12)
        assert found.quantities["peak_force"] == pytest.approx(4e4, rel=1e-9)


def test_a_monotonic_test_ends_at_its_reference():
    found = hx.simulate(study(protocol="monotonic"), {"a": 40.0}, {"k": 5e6, "F_y": 4e4}, ("elongation", "force"))
    u, f = (np.asarray(found.channels[name]) for name in ("elongation", "force"))
    assert u[-1] == pytest.approx(0.04) and np.all(np.diff(u) > 0)
    np.testing.assert_allclose(f, np.minimum(5e6 * u, 4e4), rtol=1e-6)


def test_written_and_read_again_a_study_is_the_same():
    written = study(steps=5).written()
    assert written["excitation"]["imposed"] == {"protocol": "curee", "reference": "a", "rate": 0.02, "steps": 5}
    assert hx.load_study(written).written() == written


BAD = {
    "a name that is none": ({"protocol": "cure"}, r"excitation\.imposed\.protocol: this must be 'curee', 'iso_16670'"),
    "no reference": ({"reference": None}, r"imposed\.reference: this key is required with a protocol.*0\.6 of"),
    "a reference of zero": ({"reference": 0.0}, r"imposed\.reference: a reference is positive, but it is 0"),
    "a negative reference": ({"reference": -0.04}, r"a reference is positive, but it is -0\.04"),
    "a reference that is no input": (
        {"reference": "b"},
        r"imposed\.reference: it refers to 'b', which is not an input",
    ),
    "amplitudes beside a protocol": ({"amplitudes": [0.01]}, r"imposed\.protocol: leave out amplitudes, or protocol"),
    "cycles beside a protocol": ({"cycles": 2}, r"imposed\.cycles: leave it out"),
    "neither": ({"protocol": None, "reference": None}, r"imposed\.amplitudes: give amplitudes, or a protocol \(curee"),
    "steps of amplitudes": (
        {"protocol": None, "reference": None, "amplitudes": [0.01], "steps": 3},
        r"imposed\.steps: leave out amplitudes, or steps",
    ),
    "no step": ({"steps": 0}, r"imposed\.steps: "),
    "more steps than there are": (
        {"protocol": "aci_374", "steps": 12},
        r"imposed\.steps: ACI 374\.1 has 11 steps, not 12",
    ),
    "no rate": ({"rate": None}, r"imposed\.rate: this key is required"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_protocol_that_cannot_be_is_refused(case):
    changes, said = BAD[case]
    with pytest.raises(UserError, match=said):
        Built(study(**changes)).check()


def test_a_history_that_cannot_be_is_refused():
    for arguments, said in (
        (("cure", 1.0, 1.0), "no loading protocol 'cure'; there are curee, iso_16670"),
        (("curee", 0.0, 1.0), "reference"),
        (("curee", 1.0, np.inf), "rate"),
    ):
        with pytest.raises(UserError, match=said):
            protocol_history(*arguments)
    with pytest.raises(UserError, match="multiple of 4"):
        protocol_history("curee", 1.0, 1.0, points=10)


def test_the_list_and_an_entry_say_what_there_is():
    lines = listing().splitlines()
    assert [line.split()[0] for line in lines[: len(PROTOCOLS)]] == list(PROTOCOLS)
    assert "curee      CUREE, basic loading history: 37 cycles up to 1 times the reference" in lines
    text = entry("curee")
    assert "ASTM E2126" in text and "larger by 0.5" in text
    assert "0.4 1 2" in " ".join(text.split())
    for name in PROTOCOLS:
        assert PROTOCOLS[name].relative_to in entry(name)


def test_the_page_describes_every_protocol_as_it_is():
    page = (ROOT / "docs" / "measurements.md").read_text(encoding="utf-8")
    cells = r"([^|]+) \| "
    rows = re.findall(rf"^\| `(\w+)` \| {cells}{cells}{cells}", page.partition("## Loading protocols")[2], re.MULTILINE)
    assert rows.pop(0)[0] == "protocol"
    assert [name for name, *_ in rows] == list(PROTOCOLS)
    for name, sequence, cycles, largest in rows:
        extent = PROTOCOLS[name].extent()
        assert extent == (f"one push up to {largest}" if cycles == "–" else f"{cycles} cycles up to {largest}")
        if name not in ("curee", "monotonic"):
            groups = (group.split(" × ") for group in sequence.split("; "))
            steps = [(float(a), int(count)) for count, amplitudes in groups for a in amplitudes.split(", ")]
            assert steps == [(step.amplitude, step.cycles) for step in PROTOCOLS[name].table]
    for name, increment in (("iso_16670", 0.2), ("atc_24", 1), ("fema_461", 0.3), ("sac", 0.01), ("curee", 0.5)):
        assert PROTOCOLS[name].increment == increment


def hsed(*arguments):
    return subprocess.run([sys.executable, "-m", "hsed_jax", *arguments], capture_output=True, text=True, check=False)


def test_the_command_line_refuses_an_unknown_name_with_the_list():
    done = hsed("protocols", "cure")
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert done.stderr.strip() == f"error: there is no loading protocol 'cure'; there are {', '.join(PROTOCOLS)}"


@pytest.mark.whole
def test_a_study_with_a_protocol_is_checked(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    done = hsed("check", str(tmp_path / "study.yaml"))
    assert done.returncode == 0, done.stderr
    wrong = hsed("check", str(tmp_path / "study.yaml"), "excitation.imposed.protocol=cure")
    assert wrong.returncode == 2 and "'curee'" in wrong.stderr and "Traceback" not in wrong.stderr
