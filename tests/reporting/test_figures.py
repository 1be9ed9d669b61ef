"""Every figure draws what it is given, also very little of it, says its units, and is written the same every time."""

import functools

import matplotlib
import matplotlib.text
import numpy as np
import pytest
from numpy.testing import assert_allclose

from hsed_jax.criticism.prediction import Prediction
from hsed_jax.measurements import Experiment, Record
from hsed_jax.physics import display
from hsed_jax.reporting import figures, style

INPUTS = {"V_P": "m/s", "T_P": "s"}
NAMES, UNITS = ["A", "beta", "stiffness_degradation.delta"], ["N/m", "N^(1-n)/m", "1"]


def history(m=80, scale=1.0):
    time = np.linspace(0, 8, m) if m > 1 else np.zeros(1)
    elongation = scale * 0.2 * np.sin(2 * time)
    force = 4e5 * elongation + 1e4 * np.cos(2 * time)
    return {"time": time, "elongation": elongation, "force": force, "energy": 2e4 * (1 - np.exp(-time))}


def broken(values):
    """The same with a gap and an end of NaN."""
    values = np.array(values, dtype=float)
    values[..., 1:3] = values[..., -1:] = np.nan
    return values


def motions(n=4, m=50, k=7):
    time, periods = np.linspace(0, 3, m), np.linspace(0, 2, k)
    waves = np.sin(np.outer(np.arange(1, n + 1), time))
    spectra = np.outer(np.arange(1, n + 1), np.exp(-periods))
    return time, waves, 2 * np.sin(time), periods, spectra, 2 * np.exp(-periods)


def estimates(n=12, p=3):
    middle = np.outer(1 + 1 / np.arange(1, n + 1), [4e5, 0.8, 0.1][:p])
    return middle, 0.9 * middle, 1.1 * middle, NAMES[:p], UNITS[:p]


def maps(p=2, a=6, b=5):
    x, y = np.linspace(1.5, 3, a), np.linspace(0.5, 1.5, b)
    return (x, y), np.array([4e5, 0.8, 0.1][:p])[:, None, None] * (1 + 0.1 * np.add.outer(x, y**2))


def design(n=12, d=2):
    return np.random.default_rng(0).random((n, d)), 3, np.tile([0.0, 1.0], (d, 1)), dict.fromkeys("abcde"[:d], "m")


def same(values):
    return np.full_like(np.asarray(values, dtype=float), 3.0)


def cases():
    """Name, and a function that draws it; degenerate ones included."""
    grid, values = maps()
    middle, low, high, names, units = estimates()
    references = {"A": 5e5, "beta": 1.0}
    time, waves, central, periods, spectra, one = motions()
    gaps = {name: values if name == "time" else broken(values) for name, values in history().items()}
    still = {name: values if name == "time" else 0 * values for name, values in history().items()}
    pair = ("a case", history(), history(scale=0.9))
    return {
        "motions": lambda: figures.ground_motions(*motions()),
        "motions, one": lambda: figures.ground_motions(*motions(n=1)),
        "motions, one instant": lambda: figures.ground_motions(*motions(m=1, k=1)),
        "motions, none": lambda: figures.ground_motions(time, waves[:0], central, periods, spectra[:0], one),
        "motions, many": lambda: figures.ground_motions(*motions(n=110, m=500)),
        "motions, gaps": lambda: figures.ground_motions(time, broken(waves), broken(central), periods, spectra, one),
        "motions, no finite": lambda: figures.ground_motions(
            time, np.nan * waves, central, periods, np.nan * spectra, one
        ),
        "loops": lambda: figures.loops_and_energy(history(), history(60, 0.9)),
        "loops, one sample": lambda: figures.loops_and_energy(history(1), history(1)),
        "loops, at rest": lambda: figures.loops_and_energy(still, still),
        "loops, gaps": lambda: figures.loops_and_energy(gaps, history()),
        "loops, no energy": lambda: figures.loops_and_energy({**{k: gaps[k] for k in ("time", "force")}}, history()),
        "maps": lambda: figures.estimate_maps(grid, values, NAMES[:2], UNITS[:2], INPUTS),
        "maps, one parameter": lambda: figures.estimate_maps(grid, values[:1], NAMES[:1], UNITS[:1], INPUTS),
        "maps, three": lambda: figures.estimate_maps(*maps(p=3), NAMES, UNITS, INPUTS),
        "maps, constant": lambda: figures.estimate_maps(grid, same(values), NAMES[:2], UNITS[:2], INPUTS),
        "maps, zero": lambda: figures.estimate_maps(grid, 0 * values, NAMES[:2], UNITS[:2], INPUTS),
        "maps, gaps": lambda: figures.estimate_maps(grid, broken(values), NAMES[:2], UNITS[:2], INPUTS),
        "maps, no finite": lambda: figures.estimate_maps(grid, np.nan * values, NAMES[:2], UNITS[:2], INPUTS),
        "maps, one row": lambda: figures.estimate_maps(*maps(b=1), NAMES[:2], UNITS[:2], INPUTS),
        "maps, one point": lambda: figures.estimate_maps(*maps(a=1, b=1), NAMES[:2], UNITS[:2], INPUTS),
        "improvement": lambda: figures.expected_improvement_history(np.exp(-np.arange(9.0))),
        "improvement, one": lambda: figures.expected_improvement_history([0.1]),
        "improvement, none": lambda: figures.expected_improvement_history([]),
        "improvement, zero": lambda: figures.expected_improvement_history(np.zeros(5)),
        "improvement, gaps": lambda: figures.expected_improvement_history(broken(np.ones(6))),
        "improvement, no finite": lambda: figures.expected_improvement_history(np.full(4, np.nan)),
        "order": lambda: figures.exploration_order(*design()),
        "order, one": lambda: figures.exploration_order(*design(n=1)),
        "order, twice the same": lambda: figures.exploration_order(np.ones((4, 2)), 2, *design()[2:]),
        "order, one input": lambda: figures.exploration_order(*design(d=1)),
        "order, one experiment of one input": lambda: figures.exploration_order(*design(n=1, d=1)),
        "order, three inputs": lambda: figures.exploration_order(*design(d=3)),
        "order, one of five inputs": lambda: figures.exploration_order(*design(n=1, d=5)),
        "estimates": lambda: figures.estimate_history(*estimates(), references),
        "estimates, one parameter": lambda: figures.estimate_history(*estimates(p=1)),
        "estimates, one iteration": lambda: figures.estimate_history(*estimates(n=1), references),
        "estimates, constant": lambda: figures.estimate_history(same(middle), same(low), same(high), names, units),
        "estimates, gaps": lambda: figures.estimate_history(
            broken(middle.T).T, broken(low.T).T, broken(high.T).T, names, units, references
        ),
        "estimates, no finite": lambda: figures.estimate_history(
            *(np.nan * v for v in (middle, low, high)), names, units
        ),
        "responses": lambda: figures.response_comparison([pair, ("another", history(), history(60, 2.0))]),
        "responses, one": lambda: figures.response_comparison([pair]),
        "responses, gaps": lambda: figures.response_comparison([("g", gaps, history()), ("at rest", still, still)]),
        "responses, one sample": lambda: figures.response_comparison([("g", history(1), history(1))]),
    }


CASES = cases()


@functools.cache
def drawn(case):
    return CASES[case]()


def texts(picture):
    return [text.get_text() for text in picture.figure.findobj(matplotlib.text.Text) if text.get_text()]


@pytest.mark.parametrize("case", CASES)
def test_it_draws_without_a_warning_and_says_what_it_shows(case):
    picture = drawn(case)
    assert picture.caption.endswith(".") and len(picture.alt) > 20
    assert "nan" not in picture.alt and "$" not in picture.alt + picture.caption
    assert picture.figure.get_figwidth() == 7
    for panel in picture.figure.axes:
        assert np.isfinite([*panel.get_xlim(), *panel.get_ylim()]).all()


@pytest.mark.parametrize(
    ("case", "panels", "labels"),
    [
        ("motions", 2, {"Time [s]", "Ground acceleration $a_g$ [m/s$^{2}$]", "Pseudo-acceleration $S_a$ [m/s$^{2}$]"}),
        ("loops", 2, {r"Elongation $\Delta u$ [mm]", "Force $r$ [kN]", "Time [s]", "Energy $e$ [kJ]"}),
        ("maps", 4, {"V_P [m/s]", "T_P [s]", "A [kN/m]", "beta [N$^{1-n}$/m]"}),
        ("improvement", 1, {"Iteration", r"$\max_x\, E[I(x)]$ [–]"}),
        ("order", 2, {"a [m]", "b [m]", "Order (0 first, 1 last)"}),
        ("order, one input", 1, {"a [m]", "Experiment"}),
        ("order, three inputs", 4, {"a [m]", "b [m]", "c [m]"}),
        ("estimates", 3, {"Iteration", "A [kN/m]", "beta [N$^{1-n}$/m]", "stiffness_\ndegradation.\ndelta [–]"}),
        ("responses", 6, {"Force $r$ [kN]", r"Elongation $\Delta u$ [mm]", "Energy $e$ [kJ]", "Time [s]", "another"}),
    ],
)
def test_panels_and_labels_with_units(case, panels, labels):
    picture = drawn(case)
    assert len(picture.figure.axes) == panels  # colour bars are axes of their own
    assert labels <= set(texts(picture))


def test_panels_are_lettered_when_there_are_several():
    assert {"a)", "b)", "c)"} <= set(texts(drawn("estimates")))
    assert "a)" not in texts(drawn("estimates, one parameter"))


def test_measured_and_predicted_differ_without_colour():
    panel = drawn("loops").figure.axes[0]
    measured, predicted = panel.get_lines()
    assert (measured.get_linestyle(), predicted.get_linestyle()) == ("--", "-")
    assert_allclose(measured.get_xdata(), 1e3 * history()["elongation"])
    assert_allclose(measured.get_ydata(), 1e-3 * history()["force"])


def test_a_reference_is_drawn_in_the_unit_of_its_axis_and_only_where_there_is_one():
    picture = drawn("estimates")
    lines = [[line for line in panel.get_lines() if line.get_label() == "reference"] for panel in picture.figure.axes]
    assert [len(found) for found in lines] == [1, 1, 0]
    assert_allclose(lines[0][0].get_ydata(), 500)
    assert "reference" in texts(picture)


def test_the_legend_stands_outside_the_panels():
    figure = drawn("responses").figure
    bottom = figure.legends[0].get_window_extent().y0
    assert all(bottom >= panel.get_window_extent().y1 for panel in figure.axes)


def test_the_order_map_runs_from_the_first_to_the_last_region():
    corners = np.array([[0.05, 0.05], [0.95, 0.05], [0.05, 0.95], [0.95, 0.95]])
    x = np.linspace(0, 1, 11)
    order = figures._smooth_order(corners, np.array([[0.0, 1.0], [0.0, 1.0]]), x, x)
    assert_allclose([order[0, 0], order[0, -1], order[-1, 0], order[-1, -1]], [0, 1 / 3, 2 / 3, 1], atol=0.02)


@pytest.mark.parametrize(
    ("unit", "largest", "expected"),
    [
        ("N", 2.5e5, (1e3, "kN")),
        ("N", 3e6, (1e6, "MN")),
        ("N", 12.0, (1.0, "N")),
        ("m", 0.3, (1e-3, "mm")),
        ("m", 4e3, (1.0, "m")),
        ("J", 2e4, (1e3, "kJ")),
        ("N/m", 5e5, (1e3, "kN/m")),
        ("Pa", 2e8, (1e6, "MPa")),
        ("N^(1-n)/m", 5e5, (1.0, "N^(1-n)/m")),
        ("m/s", 0.1, (1.0, "m/s")),
        ("1", 5e5, (1.0, "1")),
        ("N", 0.0, (1.0, "N")),
        ("N", np.nan, (1.0, "N")),
    ],
)
def test_units_are_scaled_for_reading(unit, largest, expected):
    assert display.readable(unit, [-largest, 0.0], []) == expected


def test_symbols_come_from_where_the_parameter_is_declared():
    assert style.symbol("beta") == r"$\beta$"
    assert style.symbol("stiffness_degradation.delta") == r"$\delta_\eta$"
    assert style.label("stiffness_degradation.delta", "1") == "stiffness_\ndegradation.\ndelta [–]"
    assert style.symbol("T_P") == "$T_{P}$"
    assert style.symbol("no_such.thing") == "no such.thing"
    assert style.symbol("amplitude_scale") == "amplitude scale"


@pytest.mark.whole
def test_saving_writes_both_files_the_same_each_time(tmp_path):
    for case in ("motions, many", "order, three inputs"):
        first = [path.read_bytes() for path in style.save(CASES[case](), tmp_path / "new" / "folder", "figure")]
        picture = CASES[case]()
        picture._repr_png_()
        paths = style.save(picture, tmp_path, "figure")
        assert [path.name for path in paths] == ["figure.png", "figure.svg"]
        assert [path.read_bytes() for path in paths] == first
        assert picture.alt.encode() in first[1]
        assert b"<text" in first[1]  # words, not outlines


def test_the_users_matplotlib_settings_neither_matter_nor_change(tmp_path):
    (_, expected) = style.save(CASES["loops"](), tmp_path, "expected")
    with matplotlib.rc_context({"font.size": 20, "axes.grid": False, "lines.linewidth": 9}):
        before = dict(matplotlib.rcParams)
        (_, found) = style.save(CASES["loops"](), tmp_path, "found")
        assert dict(matplotlib.rcParams) == before
    assert found.read_bytes() == expected.read_bytes()


def test_what_is_not_scored_is_drawn_as_it_was_measured():
    record = Record(np.arange(4.0), {"force": np.array([1.0, 2.0, 3.0, 4.0])})
    used, table = np.array([[False, False, True, True]]), np.array([[0.0, 0.0, 3.0, 4.0]])
    prediction = Prediction(
        ("force",), np.zeros(4, int), (Experiment("E01", record=record),), table, used, table, table, table, table,
        np.ones(1, bool),
    )  # fmt: skip
    panel = style.new_figure(2.0).subplots()
    np.testing.assert_array_equal(style.recorded(panel, prediction, 0, "force"), [1.0, 2.0, 3.0, 4.0])
    assert panel.get_legend_handles_labels()[1] == ["scored"]
