"""`hx.plot`: axes to go on editing, one figure each, nothing left open, nobody's settings changed, clear refusals."""

import inspect
from dataclasses import fields, replace
from types import SimpleNamespace

import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from builders.calibrations import STUDY, calibration, improvement
from builders.diagnoses import candidate, diagnosis, falling, improved
from builders.misfits import histories, quantities
from builders.outcomes import Ended, Expecting, outcome
from matplotlib.axes import Axes
from numpy.testing import assert_allclose

import hsed_jax as hx
from hsed_jax.config.experiments import ExperimentsEntry
from hsed_jax.design.sequential import DesignState, Trial
from hsed_jax.discovery.findings import Curve, Discovery
from hsed_jax.discovery.places import Place
from hsed_jax.inference.fit import Fit
from hsed_jax.measurements import Campaign, Channel, Experiment, Record, write_campaign
from hsed_jax.runs.requests import Expected
from hsed_jax.study.build import Built


def design():
    """A run of a design of two steps after one initial experiment."""
    step = {"max_expected_improvement": 0.3, "map": {"A": 4e5, "beta": 1.0},
            "posterior": {n: {"q05": 0.9 * x, "q95": 1.1 * x} for n, x in (("A", 4e5), ("beta", 1.0))}}  # fmt: skip
    space, points = Built(STUDY).experiments.space, ([0.5, 0.5], [0.2, 0.8], [0.9, 0.1])
    steps = [step, {**step, "max_expected_improvement": 0.1}]
    state = DesignState(tuple(Trial(space.point(np.array(x)), np.zeros(3), "completed") for x in points))
    found = outcome(space=space, state=state, steps=steps, laboratory=Built(STUDY).site.laboratory)
    return Ended(found)


def asked():
    """A design that asked for one experiment, of which a record was told."""
    time = np.linspace(0.0, 2.0, 21)
    band = np.stack([np.sin(time) - 0.1, np.sin(time), np.sin(time) + 0.1])
    channels = {"time": Channel("time", "s"), "force": Channel("force", "N")}
    experiment = Experiment("E01", record=Record(time, {"force": 1.1 * np.sin(time)}))
    told = Campaign("told", "ground_motion", channels=channels, experiments=(experiment,))
    found = Expected(time, {"elongation": band, "force": band}, {})
    request = SimpleNamespace(inputs={"V_P": 2.0, "T_P": 1.0})
    conduct = SimpleNamespace(request=lambda id: request, campaign=told)
    return Expecting(Built(STUDY), conduct, found)


def discovered():
    """A learned force in proportion to the elongation."""
    place = Place("force", ("elongation",))
    count = len(place.degrees)
    curve = Curve(place, ((-1.0, 1.0),), np.eye(count)[1], 1e-4 * np.eye(count))
    return Discovery(True, place=place, formula="F_c u/u_c", curve=curve)


class Replicated(Fit):
    """A fit of a population, whose levels are given."""

    def levels(self):
        told = {"mean": 4e5, "q05": 3.9e5, "q95": 4.1e5}
        of = {name: told for name in ("B1", "B2", "B3")}
        varying = {"mean": told, "spread": {"mean": 0.05}, "untested": told, "of": of}
        return {"bar": {"A": varying, "beta": varying}}


def replicates():
    """A calibration of three bars, whose stiffness and shape vary."""
    plain = calibration(histories())
    known = {field.name: getattr(plain.fit, field.name) for field in fields(Fit)}
    return replace(plain, fit=Replicated(**known))


CASES = {
    "population": (lambda: hx.plot.population(replicates()), 2),
    "learned": (lambda: hx.plot.learned(discovered(), histories(2, 1)[0]), None),
    "expected": (lambda: hx.plot.expected(asked(), "E01"), 2),
    "ground_motions": (lambda: hx.plot.ground_motions(STUDY), 2),
    "histories": (lambda: hx.plot.histories(calibration(histories(2, 1)), "E3"), 3),
    "cycles": (lambda: hx.plot.cycles(calibration(histories(2, 1))), 9),
    "loops": (lambda: hx.plot.loops(calibration(histories(2, 1))), 3),
    "where": (lambda: hx.plot.where(calibration(histories(2, 1))), 9),
    "error_map": (lambda: hx.plot.error_map(calibration(quantities(), "quantities")), None),
    "measured_against_predicted": (
        lambda: hx.plot.measured_against_predicted(calibration(quantities(), "quantities")),
        2,
    ),
    "posterior": (lambda: hx.plot.posterior(calibration(histories())), 3),
    "behaviour": (lambda: hx.plot.behaviour(replace(diagnosis([candidate("gap", 9.0)]), behaviour=falling())), 2),
    "ranking": (lambda: hx.plot.ranking(diagnosis([candidate("gap", 9.0)])), None),
    "error_fall": (lambda: hx.plot.error_fall(improvement()), None),
    "before_after": (lambda: hx.plot.before_after(improvement()), 4),
    "parameters": (lambda: hx.plot.parameters(improvement(), {"A": 5e5}), 2),
    "expected_improvement": (lambda: hx.plot.expected_improvement(design()), None),
    "exploration": (lambda: hx.plot.exploration(design()), None),
    "estimates": (lambda: hx.plot.estimates(design()), 2),
}


def test_every_plot_is_tried():
    own = {n for n, f in vars(hx.plot).items() if inspect.isfunction(f) and f.__module__ == hx.plot.__name__}
    assert {name for name in own if not name.startswith("_")} == set(CASES)


@pytest.mark.parametrize("name", CASES)
def test_axes_are_returned_and_can_be_edited_and_no_setting_changes(name, tmp_path):
    draw, count = CASES[name]
    with matplotlib.rc_context({"font.size": 20, "axes.grid": False, "axes.spines.top": True}):
        before = dict(matplotlib.rcParams)
        found = draw()
        assert dict(matplotlib.rcParams) == before
        axes = [found] if count is None else list(found)
        assert len(axes) == (count or 1) and all(isinstance(one, Axes) for one in axes)
        assert len({one.figure for one in axes}) == 1
        # The house style holds, whatever the user's is.
        assert axes[0].xaxis.label.get_fontsize() == 9 and not axes[0].spines["top"].get_visible()
        axes[0].set_title("of my own")
        axes[0].axvline(0.0)
        axes[0].figure.savefig(tmp_path / "edited.png")
    assert axes[0].get_title() == "of my own"
    assert plt.get_fignums() == []


@pytest.mark.parametrize("backend", ["inline", "tkagg"])
def test_where_figures_are_shown_pyplot_knows_each_once(monkeypatch, backend):
    monkeypatch.setattr(hx.plot.matplotlib, "get_backend", lambda: backend)
    try:
        axes = hx.plot.loops(calibration(histories(1, 1)))
        other = hx.plot.ranking(diagnosis([candidate("gap", 9.0)]))
        assert [plt.figure(number) for number in plt.get_fignums()] == [axes[0].figure, other.figure]
        assert plt.gcf() is other.figure
    finally:
        plt.close("all")


@pytest.mark.parametrize("backend", ["agg", "pdf", "svg"])
def test_a_batch_without_a_display_leaves_nothing_open(monkeypatch, backend):
    monkeypatch.setattr(hx.plot.matplotlib, "get_backend", lambda: backend)
    for _ in range(2):
        hx.plot.ranking(diagnosis([candidate("gap", 9.0)]))
    assert plt.get_fignums() == []


def test_a_history_is_that_of_the_experiment_asked_for():
    case = histories(2, 2)
    force, elongation, loop = hx.plot.histories(calibration(case), "E3")
    record = case[0]["E3"].record
    assert_allclose(force.get_lines()[0].get_ydata(), 1e-3 * record["force"])
    assert_allclose(elongation.get_lines()[1].get_ydata(), 1.1e3 * record["elongation"])
    assert_allclose(loop.get_lines()[0].get_xdata(), 1e3 * record["elongation"])


def test_loops_are_those_with_the_largest_errors_first():
    campaign, comparison, _ = histories(6, 6)
    worse = improved(comparison, np.linspace(0.01, 0.06, 6))
    axes = hx.plot.loops(calibration((campaign, worse, None)))
    titles = [axis.get_title(loc="left") for axis in axes]
    assert len(titles) == 9 and titles[0].split()[0] in ("E6", "E12") and "E1 (train)" not in titles
    errors = [float(axis.get_title(loc="right").split()[-1]) for axis in axes]
    assert errors == sorted(errors, reverse=True) and errors[0] > 2 * errors[-1]


def test_the_posterior_shows_the_draws_the_map_and_the_truth_in_one_unit():
    case = calibration(histories(), names=("A", "beta", "error.force"), at=(4e5, 1.0, 0.1))
    axes = hx.plot.posterior(case, truth={"A": 5e5})
    assert len(axes) == 6
    histogram, pair = axes[0], axes[1]
    draws = np.asarray(case.fit.chains.theta).reshape(-1, 3)
    (scatter, mark, truth) = pair.get_lines()
    assert_allclose(scatter.get_xdata(), 1e-3 * draws[:, 0])
    assert_allclose(scatter.get_ydata(), draws[:, 1])
    assert_allclose([mark.get_xdata()[0], mark.get_ydata()[0]], [400.0, 1.0])
    assert_allclose(truth.get_xdata(), 500.0)
    (area,) = histogram.patches
    edges = area.get_data().edges
    assert_allclose([edges[0], edges[-1]], 1e-3 * draws[[draws[:, 0].argmin(), draws[:, 0].argmax()], 0])
    assert axes[3].get_xlabel() == "A [kN/m]" and axes[-1].get_xlabel() == "error.force [–]"
    entries = [text.get_text() for text in axes[0].figure.legends[0].get_texts()]
    assert entries == ["draws", "MAP", "true value"]


def test_a_posterior_lies_over_the_one_before():
    better = improvement()
    axes = hx.plot.posterior(better.calibration, before=better.original)
    pair, alone = axes[1], axes[-1]
    assert_allclose([line.get_xdata()[0] for line in pair.get_lines()[1::2]], [400.0, 500.0])
    assert len(alone.patches) == 1  # the model as it was did not have the effect
    entries = [text.get_text() for text in axes[0].figure.legends[0].get_texts()]
    assert entries == ["as it was: draws", "as it was: MAP", "improved: draws", "improved: MAP"]


def test_a_sharp_posterior_does_not_flatten_a_broad_one():
    better = improvement()
    centre = np.asarray(better.calibration.map["A"])
    draws = np.asarray(better.calibration.fit.chains.theta)
    narrow = np.concatenate([centre + 1e-4 * (draws[..., :1] - centre), draws[..., 1:]], axis=-1)
    fit = better.calibration.fit
    sharp = replace(better.calibration, fit=replace(fit, chains=fit.chains._replace(theta=jnp.asarray(narrow))))
    histogram = hx.plot.posterior(sharp, before=better.original)[0]
    assert_allclose([area.get_data().values.max() for area in histogram.patches], 1.0)


def test_a_long_legend_stays_within_the_figure():
    better = improvement()
    figure = hx.plot.posterior(better.calibration, better.original, {"A": 5e5})[0].figure
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0 and box.x1 <= figure.bbox.x1


def test_cycles_are_those_of_both_models():
    better = improvement()
    axes = hx.plot.cycles(better.calibration, before=better.original)
    energy, stiffness, backbone = axes[:3]
    entries = [text.get_text() for text in energy.figure.legends[0].get_texts()]
    assert entries == ["measured", "model as it was", "improved model"]
    assert "(test)" in energy.get_title(loc="right")
    measured, old, _ = (line.get_ydata() for line in energy.get_lines())
    assert_allclose(old, 1.21 * measured)  # force and elongation are a tenth too large
    for line in stiffness.get_lines()[1:]:
        assert_allclose(line.get_ydata(), stiffness.get_lines()[0].get_ydata())
    assert_allclose(backbone.get_lines()[1].get_xdata(), 1.1 * backbone.get_lines()[0].get_xdata())


def test_the_ground_motions_of_a_measured_campaign_have_a_time(tmp_path):
    records = {f"E{i}": {"time": 0.01 * np.arange(50), "force": np.sin(np.arange(50.0))} for i in (1, 2)}
    table = {"id": ["E1", "E2"], "V_P": [2.0, 2.5], "T_P": [1.0, 1.2]}
    units = {"time": "s", "force": "N"}
    write_campaign(
        Campaign.from_frames(
            table, records, protocol="ground_motion", inputs={"V_P": "m/s", "T_P": "s"}, channels=units
        ),
        tmp_path,
    )
    study = STUDY.model_copy(update={"experiments": ExperimentsEntry(campaign=str(tmp_path))})
    motion, _ = hx.plot.ground_motions(study)
    assert motion.get_xlim() == (0.0, 10.0)


def test_of_many_parameters_six_are_shown():
    names = tuple(f"p{i}" for i in range(8))
    assert len(hx.plot.posterior(calibration(histories(), names=names, at=(1.0,) * 8))) == 21


def test_a_design_is_drawn_as_it_went():
    run = design()
    (line,) = hx.plot.expected_improvement(run).get_lines()
    assert line.get_ydata().tolist() == [0.3, 0.1]
    stiffness = hx.plot.estimates(run)[0]
    assert_allclose(stiffness.get_lines()[0].get_ydata(), 400.0)
    assert_allclose(stiffness.get_lines()[1].get_ydata(), 500.0)


def test_an_experiment_without_a_measurement_is_refused():
    campaign, comparison, _ = histories(1, 1)
    waiting = campaign.add(Experiment("E9", {}, status="pending"))
    with pytest.raises(hx.UserError, match="'E9' is pending"):
        hx.plot.histories(calibration((waiting, comparison, None)), "E9")


def flat():
    campaign, comparison, _ = histories(1, 0, outputs=("velocity_1",))
    return calibration((campaign, comparison, None))


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: hx.plot.histories(calibration(histories(1, 1)), "E7"), "no experiment 'E7'; the campaign has E1, E2"),
        (lambda: hx.plot.histories(calibration(quantities(), "quantities"), "E1"), "plot.measured_against_predicted"),
        (lambda: hx.plot.measured_against_predicted(calibration(histories())), "does not observe quantities"),
        (lambda: hx.plot.loops(flat()), "force and elongation were not both measured"),
        (lambda: hx.plot.cycles(flat()), "force and elongation were not both measured"),
        (lambda: hx.plot.where(calibration(quantities(), "quantities")), "plot.error_map"),
        (lambda: hx.plot.error_map(calibration(histories(2, 0))), "one or two inputs that vary"),
        (lambda: hx.plot.ranking(diagnosis([])), "no candidate to draw"),
        (lambda: hx.plot.learned(Discovery(False, "it is noise"), histories(1, 1)[0]), "no function to draw.*noise"),
        (lambda: hx.plot.expected_improvement(Ended()), "no steps of a design"),
        (lambda: hx.plot.ground_motions(STUDY.model_copy(update={"excitation": None})), "no excitation"),
    ],
)
def test_what_cannot_be_drawn_is_said(draw, message):
    with pytest.raises(hx.UserError, match=message):
        draw()
    assert plt.get_fignums() == []
