"""Measures of cycles against loops whose figures are known in closed form, and against an independent package."""

import csv
import io
from itertools import pairwise

import numpy as np
import pytest
from builders.places import DATA, TESTS

from hsed_jax.measurements import (
    Backbone,
    Campaign,
    Channel,
    Experiment,
    Record,
    backbone_of,
    backbone_table,
    cycle_table,
    cycles_of,
    read_campaign,
)
from hsed_jax.measurements.cycles import returned
from hsed_jax.measurements.turns import cycle_numbers, spans, turns
from hsed_jax.physics.outputs import absorbed_energy


def path_through(corners, samples: int) -> np.ndarray:
    """Straight lines from corner to corner, each corner a sample."""
    return np.concatenate(
        [np.linspace(a, b, samples, endpoint=False) for a, b in pairwise(corners)] + [np.asarray(corners[-1:], float)]
    )


def elastoplastic(u: np.ndarray, stiffness: float, strength: float) -> np.ndarray:
    force = np.zeros_like(u)
    for i in range(1, u.size):
        force[i] = np.clip(force[i - 1] + stiffness * (u[i] - u[i - 1]), -strength, strength)
    return force


# --- closed forms ----------------------------------------------------------------------------------------------------


def test_an_ellipse_has_its_area_its_stiffness_and_its_damping():
    # F = k u + h w with u = a sin, w = a cos: the area is π h a², the force at the peaks ± k a, the damping h/2k.
    k, h = 4e6, 3e5
    amplitudes = np.asarray([0.01, 0.02, 0.02, 0.03])
    t = np.linspace(0, 4, 8001)
    a = amplitudes[np.minimum(t.astype(int), 3)]
    u, force = a * np.sin(2 * np.pi * t), a * (k * np.sin(2 * np.pi * t) + h * np.cos(2 * np.pi * t))
    found = cycles_of(force, u)
    np.testing.assert_allclose(found.energy, np.pi * h * amplitudes**2, rtol=2e-3)
    np.testing.assert_allclose(found.cumulative_energy, np.cumsum(np.pi * h * amplitudes**2), rtol=2e-3)
    np.testing.assert_allclose(found.secant_stiffness, k, rtol=5e-3)
    np.testing.assert_allclose(found.damping, h / (2 * k), rtol=5e-3)
    np.testing.assert_allclose(found.elongation, np.outer([-1, 1], amplitudes), rtol=1e-5)
    # The force is zero where tan = -h/k.
    np.testing.assert_allclose(
        np.abs(found.residual), np.tile(amplitudes * np.sin(np.arctan(h / k)), (2, 1)), rtol=1e-3
    )
    assert found.group.tolist() == [0, 1, 1, 2] and np.abs(found.strength_loss).max() < 1e-6
    backbone = backbone_of(force, u, found)
    np.testing.assert_allclose(backbone.elongation, [-0.03, -0.02, -0.01, 0.01, 0.02, 0.03], rtol=1e-3)
    np.testing.assert_allclose(backbone.force, k * backbone.elongation, rtol=5e-3)


def test_a_parallelogram_has_its_area_and_the_stiffness_of_its_sides():
    # Elastic with k to Fy, then plastic, amplitude a: area 4 Fy (a - Fy/k).
    k, strength, a = 2e6, 1e4, 0.02
    yielded = strength / k
    u = path_through([0, a, -a, a, -a, 0], 400)
    found = cycles_of(elastoplastic(u, k, strength), u)
    assert found.is_whole.tolist() == [True, True] and len(found) == 2
    assert found.energy[1] == pytest.approx(4 * strength * (a - yielded), rel=1e-3)
    np.testing.assert_allclose(found.secant_stiffness, strength / a)
    assert found.damping[1] == pytest.approx(2 / np.pi * (1 - yielded / a), rel=1e-3)
    np.testing.assert_allclose(found.unloading_stiffness, k, rtol=1e-9)
    np.testing.assert_allclose(found.residual, [[-(a - yielded)] * 2, [a - yielded] * 2], rtol=1e-9)
    # From the residual elongation of one side to the peak of the other; the first loading begins at rest.
    virgin, later = strength / a, strength / (2 * a - yielded)
    np.testing.assert_allclose(found.reloading_stiffness, [[later, later], [virgin, later]], rtol=1e-9)


def test_a_friction_rectangle_has_four_times_force_times_amplitude_and_a_damping_of_two_over_pi():
    u = path_through([0, 0.02, -0.02, 0.02, -0.02, 0], 300)
    force = 5e3 * np.sign(np.diff(u, prepend=-1e-9))
    found = cycles_of(force, u)
    np.testing.assert_allclose(found.energy, 4 * 0.02 * 5e3, rtol=0.01)  # a sample of each turn is cut off
    np.testing.assert_allclose(found.damping, 2 / np.pi, rtol=0.01)
    np.testing.assert_allclose(found.secant_stiffness, 5e3 / 0.02)
    assert found.energy.sum() == pytest.approx(absorbed_energy(force, u)[-1], rel=1e-12)


def test_strength_falls_between_cycles_of_one_amplitude():
    a = np.asarray([1, 1, 1, 2, 2, 2]) * 1e-2
    strength = np.asarray([10, 9, 8, 12, 9, 6.0])
    u = path_through([0, *np.stack([a, -a], axis=1).ravel(), 0], 60)
    which = np.minimum(cycle_numbers(u), 5)
    force = strength[which] * np.tanh(u / 2e-3)
    found = cycles_of(force, u)
    expected = [0, 0.1, 0.2, 0, 0.25, 0.5]
    np.testing.assert_allclose(found.strength_loss, [expected, expected], atol=1e-3)
    first, last = (backbone_of(force, u, found, which) for which in ("first", "stabilised"))
    np.testing.assert_allclose(first.force, [-12, -10, 10, 12], rtol=1e-3)
    np.testing.assert_allclose(last.force, [-6, -8, 8, 6], rtol=1e-3)


# --- what is no cycle ------------------------------------------------------------------------------------------------


def test_cycles_begin_with_the_record_and_end_where_the_first_excursion_begins_again():
    phase = np.arange(0, 3 * 40) / 40
    for sign in (1, -1):
        np.testing.assert_array_equal(cycle_numbers(sign * np.sin(2 * np.pi * (phase + 1e-9)))[:40], 0)
        assert cycle_numbers(sign * np.sin(2 * np.pi * phase))[-1] == 2
    assert cycle_numbers(np.zeros(5)).tolist() == [0] * 5
    assert cycle_numbers(np.linspace(0, 1, 5)).tolist() == [0] * 5 and not spans(np.linspace(0, 1, 5))[0].is_whole
    noisy = np.sin(2 * np.pi * phase) + 0.02 * np.random.default_rng(0).standard_normal(phase.size)
    assert cycle_numbers(noisy)[-1] == 2


AMPLITUDES = np.asarray([1, 1, 2, 2, 4, 4, 30]) * 1e-3


def protocol(samples: int = 80) -> np.ndarray:
    """Seven cycles, the largest thirty times the smallest."""
    return path_through([0, *np.stack([AMPLITUDES, -AMPLITUDES], axis=1).ravel(), 0], samples)


def test_small_cycles_are_cycles_beside_large_ones():
    u = protocol()
    found = cycles_of(1e6 * u, u)
    assert len(found) == 7 and found.is_whole.all()
    np.testing.assert_allclose(found.elongation, np.outer([-1, 1], AMPLITUDES))
    noisy = u + 2e-5 * np.random.default_rng(0).normal(size=u.size)
    assert len(cycles_of(1e6 * noisy, noisy)) == 7


def slips(u):
    """Back by a tenth of the amplitude and forward again, half-way to a peak, at it, and near zero."""
    for at in (1000, 640, 395, 70):
        back = 0.1 * np.abs(u[at - 60 : at + 60]).max()
        step = np.interp(np.arange(20), [0, 9, 19], [0, -back, 0]) * np.sign(u[at + 1] - u[at])
        u = np.concatenate([u[:at], u[at] + step, u[at:]])
    return u


def holds(u):
    for at in (1050, 640, 400, 80, 3):
        u = np.insert(u, at, np.full(50, u[at]))
    return u


FAULTS = {
    "slips": slips,
    "holds": holds,
    "cuts": lambda u: np.delete(u, [*range(30, 50), *range(500, 540), *range(1000, 1060)]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_slips_holds_and_cuts_make_no_cycle(fault):
    u = FAULTS[fault](protocol())
    found = cycles_of(1e6 * u, u)
    assert len(found) == 7
    np.testing.assert_allclose(found.amplitude, AMPLITUDES, rtol=0.13)  # a slip at a peak goes beyond it


def test_a_hold_at_the_peak_in_which_the_force_relaxes_has_the_force_before_it():
    u = holds(protocol())
    force = 1e6 * u
    at = slice(500, 551)
    assert (u[at] == AMPLITUDES[2]).all()
    force[at] *= np.linspace(1, 0.7, 51)
    assert cycles_of(force, u).force[1, 2] == pytest.approx(1e6 * AMPLITUDES[2])


@pytest.mark.parametrize(("begin", "cycles", "whole"), [
    (80 * 4 + 28, 5, 5),  # just after zero: of the third cycle nothing is lacking
    (80 * 4 + 50, 5, 4),  # before a peak: the cycle lacks its beginning
    (80 * 5 + 20, 6, 4),  # after a peak: the cycles that follow are those of the other side, the last one lacks its end
    (80 * 6 + 20, 5, 4),  # after a peak of the other side: those that follow are the record's
])  # fmt: skip
def test_a_window_that_begins_in_the_middle_of_a_cycle_begins_its_cycles_there(begin, cycles, whole):
    u = protocol()[begin:]
    found = cycles_of(1e6 * u, u)
    assert (len(found), int(found.is_whole.sum())) == (cycles, whole)
    assert found.begin[0] == 0 and found.end[-1] == u.size and (found.begin[1:] == found.end[:-1]).all()
    # What follows is complete.
    assert np.nanmax(found.amplitude) == AMPLITUDES[-1] and np.isnan(found.secant_stiffness[0]) == (whole < 5)


def test_cycles_that_keep_to_one_side_go_from_turn_to_turn():
    tops = [1, 1, 3, 3, 9]
    u = path_through([0, *np.stack([tops, np.full(5, 0.2)], axis=1).ravel()], 50)
    found = cycles_of(2 * u, u)
    assert len(found) == 5
    np.testing.assert_allclose(found.elongation[1], tops)
    backbone = backbone_of(2 * u, u, found)
    np.testing.assert_allclose(backbone.elongation, [1, 3, 9])
    about_a_mean = 5 + np.sin(np.linspace(0, 8 * np.pi, 401))
    found = cycles_of(about_a_mean, about_a_mean)
    assert found.is_whole.tolist() == [True] * 4 + [False]  # the last quarter is the beginning of a fifth


# --- peaks -----------------------------------------------------------------------------------------------------------


def steep_loop(samples=25):
    """Cycles of a friction element of 6 kN whose force has fallen to 2 kN at the very sample of each reversal."""
    corners = np.asarray([0.0, 1, -1, 2, -2, 3, -3, 0]) * 1e-2
    u = path_through(corners, samples)
    force = 6e3 * np.sign(np.diff(u, prepend=-1e-9))
    at = samples * np.arange(1, corners.size - 1)
    force[at] /= 3
    return u, force, at


def test_the_force_at_a_peak_is_the_one_before_a_steep_unloading():
    u, force, at = steep_loop()
    assert np.abs(force[at]).tolist() == [2e3] * 6
    found = cycles_of(force, u)
    backbone = backbone_of(force, u, found)
    np.testing.assert_allclose(backbone.elongation, [-0.03, -0.02, -0.01, 0.01, 0.02, 0.03])
    np.testing.assert_allclose(backbone.force, 6e3 * np.sign(backbone.elongation))
    np.testing.assert_allclose(found.secant_stiffness, 6e3 / np.asarray([0.01, 0.02, 0.03]))


def test_a_force_that_falls_before_the_peak_is_two_points_of_the_backbone():
    u = path_through([0, 1, -1, 3, -3, 0], 200)
    force = np.where(np.abs(u) > 2, 0.3, 1.0) * 6 * np.clip(u, -1, 1)
    backbone = backbone_of(force, u, cycles_of(force, u))
    positive = backbone.side(1)
    np.testing.assert_allclose(positive[0], [0, 1, 1.02, 3], atol=0.02)
    np.testing.assert_allclose(positive[1], [0, 6, 6, 1.8])


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_record_that_begins_on_the_way_back_has_no_peak_at_its_first_sample(noise):
    u, force, at = steep_loop()
    begin = at[3] + 3  # beyond 17 mm, on the way back from -20 mm
    u, force = u[begin:] + noise * np.random.default_rng(0).normal(size=u.size - begin), force[begin:]
    found = cycles_of(force, u)
    backbone = backbone_of(force, u, found)
    np.testing.assert_allclose(backbone.elongation, [-0.03, 0.03], rtol=0.02)
    np.testing.assert_allclose(backbone.force, [-6e3, 6e3])
    assert np.isnan(found.secant_stiffness[0]) and not found.is_whole[0]


def test_a_cycle_that_returns_more_energy_than_it_was_given_is_told():
    u, force, _ = steep_loop()
    found = cycles_of(force, u)
    assert returned(found, u, force) == []
    turned = np.where(cycle_numbers(u) == 1, -force, force)
    assert returned(cycles_of(turned, u), u, turned) == [2]
    # An elastic loop with noise returns what it was given, and the last cycle may end where it likes.
    noisy = 1e5 * u + 20.0 * np.random.default_rng(0).normal(size=u.size)
    assert returned(cycles_of(noisy, u), u, noisy) == []


def test_a_prediction_is_read_over_the_cycles_of_what_was_measured():
    u, force, _ = steep_loop()
    along = cycles_of(force, u)
    wandering = u + 0.05  # crosses no zero
    ours = cycles_of(force, wandering, u)
    assert len(ours) == len(along) == 3 and (ours.begin == along.begin).all()


def test_what_is_no_loop_is_refused():
    with pytest.raises(ValueError, match="shapes"):
        cycles_of(np.zeros(5), np.zeros(6))
    with pytest.raises(ValueError, match="finite"):
        cycles_of(np.full(5, np.nan), np.zeros(5))


# --- idealised backbones ---------------------------------------------------------------------------------------------


def envelope(u, f) -> Backbone:
    u, f = np.asarray(u, float), np.asarray(f, float)
    return Backbone(np.concatenate([-u[::-1], u]), np.concatenate([-2 * f[::-1], f]))


def test_an_elastic_plastic_backbone_is_its_own_idealisation():
    backbone = envelope([1, 2, 5, 8], [5, 10, 10, 10])
    for sign, factor in ((1, 1), (-1, 2)):
        for curve in (backbone.eeep(sign), backbone.asce41(sign)):
            assert curve.yield_elongation == pytest.approx(2) and curve.yield_force == pytest.approx(10 * factor)
            assert curve.stiffness == pytest.approx(5 * factor) and not curve.failed
            assert curve.ultimate_elongation == 8 and curve.ductility == pytest.approx(4)
    component = backbone.asce41(1)
    assert (component.a, component.b, component.c) == pytest.approx((6, 6, 1))


def test_a_backbone_that_hardens_and_falls_has_the_figures_of_its_standards_by_hand():
    # Lines through (1, 10), (3, 14), then down to (5, 7): 80 % of 14 is reached at 3.8.
    backbone = envelope([1, 3, 5], [10, 14, 7])
    eeep = backbone.eeep(1)
    area, stiffness = 5 + 24 + 0.8 * 0.5 * (14 + 11.2), 10.0
    assert eeep.failed and eeep.ultimate_elongation == pytest.approx(3.8) and eeep.stiffness == pytest.approx(stiffness)
    assert eeep.yield_force == pytest.approx(stiffness * (3.8 - np.sqrt(3.8**2 - 2 * area / stiffness)))
    assert 0.5 * eeep.yield_force * eeep.yield_elongation + eeep.yield_force * (3.8 - eeep.yield_elongation) == (
        pytest.approx(area)
    )
    bilinear = backbone.bilinear(
        1
    )  # 60 % of its yield force is on the first line, and the two lines are the backbone's
    assert (bilinear.yield_elongation, bilinear.yield_force) == pytest.approx((1, 10))
    component = backbone.asce41(1)
    assert (component.a, component.b, component.c) == pytest.approx((2.8, 4, 0.7))
    assert component.ultimate_force == pytest.approx(11.2)


def test_a_backbone_of_two_points_has_no_idealisation():
    backbone = envelope([1], [10])
    assert backbone.eeep(1) is None and backbone.bilinear(1) is None and backbone.asce41(-1) is None


# --- an independent package ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_the_eeep_curve_is_that_of_an_independent_package(seed):
    package = pytest.importorskip("hysteresis")
    draw = np.random.default_rng(seed)
    u = np.cumsum(draw.uniform(0.5, 2, 7))
    f = 10 * np.tanh(u / 3) * np.where(u > u[4], draw.uniform(0.5, 0.9), 1.0)
    curve = envelope(u, f).eeep(1)
    theirs = package.fitEEEP(package.SimpleCurve(np.column_stack([np.append(0, u), np.append(0, f)])))
    assert curve.yield_elongation == pytest.approx(theirs.xy[1, 0], rel=1e-6)
    assert curve.yield_force == pytest.approx(theirs.xy[1, 1], rel=1e-6)
    assert curve.ultimate_elongation == pytest.approx(theirs.xy[2, 0], rel=1e-6)


RECORDS = {"steel_damper": "first_cycles", "rc_column": "first_cycles", "timber_connection": "first_cycles"}


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured campaigns are not at {DATA}")
@pytest.mark.parametrize("name", RECORDS)
def test_turns_and_energy_of_measured_records_are_those_of_an_independent_package(name):
    package = pytest.importorskip("hysteresis")
    record = read_campaign(DATA / name)[RECORDS[name]].record
    force, u = record["force"], record["elongation"]
    found = cycles_of(force, u)
    theirs = package.Hysteresis(np.column_stack([u, force]), revProminence=0.005 * np.ptp(u))
    # Every peak of a cycle is one of its reversals, and between two of these the work is the same.
    reversals = np.asarray(theirs.reversalIndexes)
    ours = np.sort(found.at[np.isfinite(found.elongation)])
    assert all(np.abs(reversals - at).min() <= 1 for at in ours)
    work = absorbed_energy(force, u)
    for cycle in theirs.cycles:
        cycle.setArea()
    areas = np.asarray([cycle.area.sum() for cycle in theirs.cycles])
    np.testing.assert_allclose(np.cumsum(areas), work[reversals[1:]], rtol=1e-9, atol=1e-9 * abs(work[-1]))
    assert found.cumulative_energy[-1] == pytest.approx(areas.sum(), rel=1e-9)


MEASURED = {
    ("rc_column", "first_cycles"): 8, ("timber_connection", "first_cycles"): 27, ("steel_damper", "first_cycles"): 11,
    ("friction_damper", "harmonic_025Hz"): 7,
}  # fmt: skip
"""Cycles counted by eye in the elongation over the rows."""


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured campaigns are not at {DATA}")
@pytest.mark.parametrize("name", MEASURED, ids=lambda name: name[0])
def test_cycles_of_measured_records(name):
    record = read_campaign(DATA / name[0])[name[1]].record
    found = cycles_of(record["force"], record["elongation"])
    assert len(found) == MEASURED[name]
    assert returned(found, record["elongation"], record["force"]) == [] and turns(record["elongation"]).size >= 2 * len(
        found
    )


# --- tables ----------------------------------------------------------------------------------------------------------


def a_test(units=("mm", "kN"), **window) -> Campaign:
    u = path_through([0, 10, -10, 20, -20, 0], 50)
    record = Record(np.arange(u.size, dtype=float), {"elongation": 1e-3 * u, "force": 1e3 * np.clip(2 * u, -25, 25)})
    channels = {name: Channel(name, unit) for name, unit in zip(("elongation", "force"), units, strict=True)}
    return Campaign("x", "displacement", channels=channels, experiments=(Experiment("E01", record=record, **window),))


def test_tables_are_in_the_declared_units_and_a_csv_is_read_back(tmp_path):
    table = cycle_table(a_test())
    assert table.heads[:6] == ["experiment", "cycle", "whole", "elongation- [mm]", "elongation+ [mm]", "force- [kN]"]
    first = dict(zip(table.heads, table.rows[0], strict=True))
    assert (first["elongation+ [mm]"], first["force- [kN]"]) == pytest.approx((10, -20))
    assert first["secant stiffness [kN/mm]"] == pytest.approx(2)
    written = list(csv.DictReader(io.StringIO(table.csv())))
    assert len(written) == 2 and float(written[1]["elongation- [mm]"]) == pytest.approx(-20)
    assert str(table).startswith("2 cycles\n")
    curves = [row[1:4] for row in backbone_table(a_test()).rows]
    assert curves == [
        ["first", side, curve] for side in ("negative", "positive") for curve in ("EEEP", "bilinear", "a-b-c")
    ]


def test_a_window_has_the_cycles_of_the_window_and_a_moment_is_a_moment():
    table = cycle_table(a_test(window=(0.0, 120.0)))  # to the end of the first cycle and a tenth of the second
    assert [row[2] for row in table.rows] == ["yes", "no"] and np.isnan(table.rows[1][3])
    assert "moment- [kN*m]" in cycle_table(a_test(("mrad", "kN*m"))).heads


def test_small_cycles_with_noise_in_both_channels_return_nothing():
    rng = np.random.default_rng(4)
    time = np.linspace(0, 10, 1001)
    # Free vibration of an elastic spring: the last cycles are of the size of the noise.
    u = 0.05 * np.exp(-0.4 * time) * np.sin(2 * np.pi * 1.5 * time)
    doubted = 0
    for _ in range(40):
        measured = u + 5e-4 * rng.standard_normal(u.size), 1e5 * u + 50.0 * rng.standard_normal(u.size)
        doubted += bool(returned(cycles_of(measured[1], measured[0]), *measured))
    assert doubted <= 2


# --- what the authors of a database of walls read from the same curves -----------------------------------------------

CURVES = DATA / "stone_masonry" / "curves"


@pytest.fixture(scope="module")
def published() -> dict[str, dict[str, float]]:
    """Published values of 21 walls by curve, in mm, kN and percent of the height."""
    lines = (TESTS / "data" / "stone_masonry_published.csv").read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    return {row.pop("curve"): {name: float(value) for name, value in row.items()} for row in rows}


@pytest.fixture(scope="module")
def read_from_curves(published):
    """The same values as read here, and the height by the columns of displacement and drift."""
    found = {}
    for name in published:
        lines = (CURVES / f"{name}.csv").read_bytes().decode("latin-1").splitlines()[4:]
        table = np.asarray([[float(cell or "nan") for cell in line.split(",")[:3]] for line in lines])
        height = float(np.polyfit(*table[np.isfinite(table).all(axis=1)][:, [2, 0]].T, 1)[0]) * 100
        u, force = table[np.isfinite(table[:, :2]).all(axis=1), :2].T
        backbone = backbone_of(force, u, cycles_of(force, u))
        values = {"h [mm]": height}
        for side, sign in ((1.0, "+"), (-1.0, "-")):
            elongation, forces = backbone.side(side)
            curve = backbone.eeep(side)
            assert curve is not None
            values[f"V_max,{sign} [kN]"] = float(forces.max())
            values[f"d_max,{sign} [%]"] = 100 * float(elongation[np.argmax(forces)]) / height
            values[f"V_u,{sign} [kN]"] = curve.yield_force
            values[f"d_u,{sign} [%]"] = 100 * curve.ultimate_elongation / height
        found[name] = values
    return found


is_there = pytest.mark.skipif(not CURVES.is_dir(), reason=f"the curves of the stone masonry walls are not at {CURVES}")


@is_there
def test_the_height_of_published_walls_is_that_of_their_drift(published, read_from_curves):
    for name, values in published.items():
        assert read_from_curves[name]["h [mm]"] == pytest.approx(values["h [mm]"], abs=1.0), name


@is_there
@pytest.mark.parametrize(
    ("measure", "each", "median"),
    [
        # The authors took the envelope of the raw data, here it has the points of the cycles: single ones differ.
        ("V_max", 0.04, 0.003),
        # A flat top has its largest force anywhere.
        ("d_max", 0.35, 0.05),
        # Their first line has the secant stiffness at 0.7 of the largest force, that of ASTM E2126 at 0.4.
        ("V_u", 0.12, 0.03),
        ("d_u", 0.35, 0.03),
    ],
)
def test_backbones_have_the_measures_that_were_published(published, read_from_curves, measure, each, median):
    names = [name for name in next(iter(published.values())) if name.startswith(measure)]
    pairs = [(read_from_curves[curve][name], values[name]) for curve, values in published.items() for name in names]
    off = np.asarray([abs(read / value - 1) for read, value in pairs])
    assert off.size == 42 and off.max() < each and np.median(off) < median
