"""The figures of the misfit are drawn from any comparison, also a very small or broken one, without a warning."""

import functools
from dataclasses import replace
from itertools import pairwise

import matplotlib.text
import numpy as np
import pytest
import xarray as xr
from builders.misfits import histories, quantities
from numpy.testing import assert_allclose

from hsed_jax.criticism.compare import compare
from hsed_jax.criticism.error_map import error_map
from hsed_jax.criticism.locate import Location, locate
from hsed_jax.reporting import misfit_figures
from hsed_jax.reporting.cycle_figures import cycles
from hsed_jax.reporting.diagnosis_figures import before_after
from hsed_jax.reporting.misfit_figures import misfit_drawings
from hsed_jax.reporting.misfit_maps import residual_coordinates


def still(channels):
    channels.update({name: np.zeros_like(values) for name, values in channels.items()})


def gaps(channels):
    force = channels["force"].copy()
    force[5:9] = force[-1] = np.nan
    channels["force"] = force


CASES = {
    "two outputs": lambda: histories(),
    "imposed, rows": lambda: histories(outputs=("force",), protocol="displacement", time=False, window=True),
    "imposed, time": lambda: histories(outputs=("force",), protocol="displacement", inputs=1),
    "three outputs, two inputs": lambda: histories(2, 0, 60, outputs=("force", "elongation", "velocity_1"), inputs=2),
    "three inputs": lambda: histories(2, 0, outputs=("force",), inputs=3),
    "no force": lambda: histories(outputs=("velocity_1",)),
    "one": lambda: histories(1, 0, outputs=("force",), inputs=2),
    "few samples": lambda: histories(1, 0, 6),
    "at rest": lambda: histories(2, 0, outputs=("force",), change=still, inputs=2),
    "gaps": lambda: histories(1, 0, change=gaps),
    "strange names": lambda: histories(1, 0, id="a $long$ 100 % name_" + 60 * "x" + "{}"),
    "quantities": lambda: quantities(),
    "quantities, one": lambda: quantities(1, 0),
    "quantities, two": lambda: quantities(2, 0),
    "quantities, one input": lambda: quantities(inputs=1),
    "quantities, no inputs": lambda: quantities(inputs=0),
    "quantities, three inputs": lambda: quantities(inputs=3, outputs=("peak_force",)),
    "quantities, the same": lambda: quantities(scale=2.0),
    "quantities, nothing": lambda: quantities(scale=0.0),
}


@functools.cache
def case(name):
    return CASES[name]()


@functools.cache
def drawn(name):
    campaign, comparison, location = case(name)
    return pictures_of(misfit_drawings(comparison, location, error_map(comparison, campaign), campaign))


def pictures_of(drawings):
    drawn = {name: draw() for name, draw in drawings}
    return {name: picture for name, picture in drawn.items() if picture is not None}


def texts(picture):
    found = picture.figure.findobj(matplotlib.text.Text)
    for panel in picture.figure.axes:  # a table keeps its own
        found += [cell.get_text() for table in panel.tables for cell in table.get_celld().values()]
    return [text.get_text() for text in found if text.get_text()]


@pytest.mark.parametrize("name", CASES)
def test_every_picture_is_drawn_without_a_warning_and_says_what_it_shows(name):
    pictures = drawn(name)
    assert pictures
    for picture in pictures.values():
        assert picture.caption.endswith(".") and len(picture.alt) > 20
        assert "nan" not in picture.alt and "$" not in picture.alt + picture.caption
        for panel in picture.figure.axes:
            assert np.isfinite([*panel.get_xlim(), *panel.get_ylim()]).all()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("two outputs", {"overlay_E1", "overlay_E2", "residual_coordinates", "error_table"}),
        (
            "imposed, time",
            {"overlay_E1", "overlay_E2", "residual_coordinates", "error_map", "error_table"},
        ),
        ("quantities", {"measured_against_predicted", "error_map", "error_table"}),
        ("quantities, three inputs", {"measured_against_predicted", "error_table"}),
        ("quantities, one", {"measured_against_predicted"}),
    ],
)
def test_the_pictures_that_there_is_material_for(name, expected):
    assert drawn(name).keys() == expected


def test_of_many_experiments_the_worst_are_shown(monkeypatch):
    campaign, comparison, _ = histories(8, 7, 40)
    for name in ("overlay", "error_map"):
        monkeypatch.setattr(misfit_figures, name, lambda *_: "drawn")
    pictures = pictures_of(misfit_drawings(comparison, None, None, campaign))
    overlays = {name.removeprefix("overlay_") for name in pictures if name.startswith("overlay_")}
    assert len(overlays) == 12
    for split in (comparison.train, comparison.test):
        errors = {id: max(v["nrmse"] for v in values.values()) for id, values in split.per_experiment.items()}
        left = [errors[id] for id in errors if id not in overlays]
        assert max(left) <= min(errors[id] for id in errors if id in overlays)
    assert len(pictures["error_table"].figure.axes[0].tables[0].get_celld()) == 26 * 9
    assert "5 more are not shown" in pictures["error_table"].caption


@pytest.mark.parametrize(
    ("name", "picture", "panels", "labels"),
    [
        ("two outputs", "overlay_E1", 3, {"Time [s]", "Force $r$ [kN]", r"Elongation $\Delta u$ [mm]", "E1 (train)"}),
        ("imposed, rows", "overlay_E2", 2, {"Row", "Force $r$ [kN]", r"Elongation $\Delta u$ [mm]", "scored"}),
        ("no force", "overlay_E1", 1, {"Time [s]", r"Velocity 1 $\dot u_{1}$ [m/s]"}),
        ("three outputs, two inputs", "residual_coordinates", 11,
         {"Time [s]", "Cycle", r"Elongation $|\Delta u|$ [mm]", "Absorbed energy [kJ]", "Elongation rate [mm/s]",
          "V_P [cm/s]", "T_P [s]", "Branch: share [%]", "Experiment: share [%]"}),
        ("imposed, rows", "residual_coordinates", 6, {"Row", "Cycle", "Share [%]", "Sign of the force: share [%]"}),
        ("quantities", "error_map", 2, {"V_P [cm/s]", "T_P [s]", "Squared error [–]", "train", "test"}),
        ("quantities, one input", "error_map", 1, {"V_P [cm/s]", "Squared error [–]", "Kriging mean", "90 % band"}),
        ("quantities", "measured_against_predicted", 2,
         {r"Peak force $\max|r|$, measured [kN]", "predicted [kN]", "predicted [kJ]", "train", "test"}),
        ("two outputs", "error_table", 1, {"experiment", "E1", "train", "energy", "coverage"}),
    ],
)  # fmt: skip
def test_panels_and_labels_with_units(name, picture, panels, labels):
    found = drawn(name)[picture]
    assert len(found.figure.axes) == panels
    assert labels <= set(texts(found))


def test_an_overlay_shows_measured_and_predicted_in_the_unit_of_its_axis():
    campaign, comparison, _ = case("imposed, rows")
    history, loop = drawn("imposed, rows")["overlay_E1"].figure.axes
    measured, predicted = history.get_lines()
    record = campaign["E1"].record
    assert (measured.get_linestyle(), predicted.get_linestyle()) == ("--", "-")
    assert_allclose(measured.get_ydata(), 1e-3 * record["force"])  # all of it, not only what is scored
    assert_allclose(predicted.get_ydata(), 1e-3 * comparison.train_prediction.predicted[0, : len(record)])
    inside = campaign["E1"].in_window
    assert_allclose(loop.get_lines()[1].get_xdata()[inside], 1e3 * record["elongation"][inside])
    assert np.isnan(loop.get_lines()[1].get_xdata()[~inside]).all()


def test_the_bars_of_a_coordinate_are_shares_and_the_ranked_part_is_marked():
    location = case("three outputs, two inputs")[2]
    picture = drawn("three outputs, two inputs")["residual_coordinates"]
    marked = [text for text in texts(picture) if text.startswith("no. ")]
    assert sorted(marked) == sorted(f"no. {i}: {100 * p.error_share:.0f} %" for i, p in enumerate(location.places, 1))
    for panel in picture.figure.axes:
        bars = [bar for container in panel.containers for bar in container]
        along = "get_height" if "share" not in panel.get_xlabel() else "get_width"
        assert_allclose(sum(getattr(bar, along)() for bar in bars), 100, rtol=1e-9)


def test_what_a_bar_shows_is_the_share_of_its_tenth():
    samples = case("imposed, time")[2].samples
    panel = drawn("imposed, time")["residual_coordinates"].figure.axes[0]
    assert panel.get_xlabel() == "Time [s]"
    heights = [bar.get_height() for bar in panel.containers[0]]
    first = samples.numbers["time"] < np.quantile(samples.numbers["time"], 0.1, method="inverted_cdf")
    assert_allclose(heights[0], 100 * samples.share[first].sum())


def test_an_even_misfit_is_drawn_and_one_without_samples_is_not():
    campaign, _, location = case("two outputs")
    even = Location([], replace(location.samples, share=np.full(location.samples.share.size, 1e-3)))
    picture = residual_coordinates(even, campaign)
    assert not [text for text in texts(picture) if text.startswith("no. ")]
    assert residual_coordinates(Location([], None), campaign) is None


def test_a_diverged_simulation_is_said_and_drawn():
    campaign, comparison, _ = case("no force")
    train = comparison.train_prediction
    nothing = np.full_like(train.predicted, np.nan)
    failed = replace(train, predicted=nothing, mean=nothing, sd=nothing, converged=np.zeros(1, dtype=bool))
    picture = misfit_figures.overlay(failed, 0, {}, campaign)
    assert "E1 (train, simulation diverged)" in texts(picture)


@pytest.mark.filterwarnings("error")
def test_what_diverged_is_kept_off_the_axes():
    campaign, comparison, _ = case("two outputs")
    train = comparison.train_prediction
    wild = replace(train, predicted=1e155 * train.predicted)
    broken = compare(wild, comparison.test_prediction, np.ones(2, dtype=bool), 2, [])
    drawings = misfit_drawings(broken, locate(wild, campaign), error_map(broken, campaign), campaign)
    for name, picture in pictures_of(drawings).items():
        for panel in picture.figure.axes:
            assert np.abs([*panel.get_xlim(), *panel.get_ylim()]).max() < 1e3, name
    assert "diverged" in texts(misfit_figures.error_table(broken, campaign))
    assert "error diverged" in texts(misfit_figures.loops(broken, campaign))
    assert cycles(broken, campaign) is not None


def test_labels_of_four_channels_do_not_overlap(monkeypatch):
    names = ("displacement_1", "velocity_1", "acceleration_1_absolute", "force")
    campaign, comparison, _ = histories(outputs=names, inputs=0)
    for picture in (
        misfit_figures.overlay(comparison.train_prediction, 0, {}, campaign),
        before_after(comparison, comparison, campaign),
    ):
        picture.figure.draw_without_rendering()
        boxes = [panel.yaxis.label.get_window_extent() for panel in picture.figure.axes]
        assert all(above.y0 > below.y1 for above, below in pairwise(boxes))


def test_captions_name_what_the_panels_show():
    caption = drawn("two outputs")["overlay_E1"].caption
    assert "a) force, b) elongation, c) hysteresis loop" in caption and "Shaded" not in caption
    assert "Shaded: the part of the record that is scored." in drawn("imposed, rows")["overlay_E1"].caption


def test_the_error_map_holds_the_error_of_every_experiment_and_a_kriging_through_them():
    campaign, comparison, _ = case("quantities")
    found = error_map(comparison, campaign)
    size = np.asarray([e.quantities["peak_force"] for e in campaign])
    is_train = np.asarray([e.split == "train" for e in campaign])
    assert_allclose(found["squared_error"], (0.1 * size) ** 2 / size[is_train].var(), rtol=1e-9)
    assert found["split"].values.tolist() == [e.split for e in campaign]
    assert found["V_P"].attrs["units"] == "cm/s"
    at = {name: ("experiment", found["at"].values[:, i]) for i, name in enumerate(found["input"].values)}
    near = found["squared_error_mean"].interp({name: xr.Variable(*points) for name, points in at.items()})
    assert_allclose(near, found["squared_error"], atol=0.05 * float(found["squared_error"].max()))


def test_the_table_has_the_worst_first_and_dashes_for_what_is_not_known():
    table = drawn("quantities")["error_table"].figure.axes[0].tables[0]
    errors = [float(table[row, 3].get_text().get_text()) for row in range(1, 25)]
    assert errors == sorted(errors, reverse=True)
    campaign, comparison, _ = case("quantities, two")
    broken = {
        id: {o: {**v, "nrmse": np.nan} for o, v in x.items()} for id, x in comparison.train.per_experiment.items()
    }
    comparison = replace(comparison, train=replace(comparison.train, per_experiment=broken))
    assert "–" in texts(misfit_figures.error_table(comparison, campaign))
    assert error_map(comparison, campaign) is None
