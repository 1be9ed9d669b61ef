"""The figures of a diagnosis and an improvement show the numbers of their objects; the page of effects is up to date."""

import importlib.util
from dataclasses import replace
from itertools import pairwise

import matplotlib.text
import numpy as np
import pytest
from builders.calibrations import fitted
from builders.diagnoses import candidate, diagnosis, falling, improved
from builders.misfits import histories, quantities
from builders.outcomes import outcome
from builders.places import ROOT
from numpy.testing import assert_allclose

from hsed_jax.behaviour.findings import Behaviours
from hsed_jax.criticism.improve import Step, Trail
from hsed_jax.reporting import behaviour_figures, diagnosis_figures, style
from hsed_jax.reporting.diagnosis_figures import before_after, error_fall, parameters_before_after, ranking
from hsed_jax.reporting.inline_svg import inline
from hsed_jax.reporting.posterior_figures import posterior
from hsed_jax.runs.figures import diagnosis_drawings
from hsed_jax.runs.results import _ranking

POSTERIOR = {
    "A": {"mean": 4e5, "sd": 6e3, "q05": 3.9e5, "q95": 4.1e5},
    "beta": {"mean": 0.7, "sd": 0.1, "q05": 0.6, "q95": 0.9},
    "error.force": {"mean": 0.1, "sd": 0.1, "q05": 0.1, "q95": 0.1},
}
IMPROVED = {
    "A": {"mean": 5e5, "sd": 6e3, "q05": 4.9e5, "q95": 5.2e5},
    "beta": {"mean": 1.0, "sd": 0.1, "q05": 0.9, "q95": 1.2},
    "stiffness_degradation.delta": {"mean": 0.4, "sd": 0.1, "q05": 0.3, "q95": 0.5},
}


def test_what_a_specimen_does_is_drawn_where_it_differs_and_said():
    found = falling()
    assert found.sentence == (
        "initial stiffness falls from 3 to 1 MN/m with the absorbed energy (90 %: 0.9 to 1.1); strength stays within 1 % of 40 kN"
    )
    assert "initial stiffness [MN/m]" in str(found) and "the absorbed energy (0.97)" in str(found)
    picture = behaviour_figures.behaviour(found)
    assert picture is not None
    drawn = [axis for axis in picture.figure.axes if axis.get_lines()]
    # Recentring is the same before and after, and along the test.
    assert [axis.get_title() for axis in drawn] == ["initial stiffness", "strength in tension"]
    before, after = drawn[0].get_lines()
    assert_allclose(before.get_ydata(), 2.0)
    assert_allclose(after.get_ydata(), 3 - 2 * np.linspace(0, 1, 5))
    assert "falls from 3 to 1 MN/m" in picture.alt
    assert behaviour_figures.behaviour(Behaviours()) is None


def texts(picture):
    return [text.get_text() for text in picture.figure.findobj(matplotlib.text.Text) if text.get_text()]


def with_error(one, error):
    return replace(one, error_test=error)


def test_a_bar_is_the_error_with_a_candidate_and_named_effects_and_look_alikes_stand_out():
    found = diagnosis(
        [
            with_error(candidate("pinching", 800.0, 0.97), 0.06),
            with_error(candidate("slip", 790.5, 0.03), 0.07),
            with_error(candidate("gap", -2.0, 1e-9), 2.0),
            with_error(candidate("fracture", -np.inf), np.inf),
        ],
        ["pinching"],
        [["pinching", "slip"]],
    )
    picture = ranking(found)
    (panel,) = picture.figure.axes
    bars = {container.get_label(): container for container in panel.containers}
    # Errors of more than 1.25 times that of the model as it was are cut, where those that matter can be seen.
    widths = [bar.get_width() for container in bars.values() for bar in container]
    assert_allclose(widths, [0.06, 0.07, 1.25 * 0.3, 1.25 * 0.3])
    assert_allclose(panel.get_xlim(), (0.0, 1.25 * 0.3))
    (cut, before) = panel.get_lines()
    assert cut.get_ydata().tolist() == [-2.0, -3.0]
    assert before.get_label() == "model as it was" and before.get_xdata() == [0.3, 0.3]
    assert list(bars) == ["named", "look-alike of a named effect", "other candidates"]
    assert bars["look-alike of a named effect"][0].get_hatch()
    assert [tick.get_text() for tick in panel.get_yticklabels()] == ["pinching", "slip", "gap", "fracture"]
    assert {"0.970", "0.030", "< 0.001", "0.060", "0.070", "2.000", "diverged"} <= set(texts(picture))
    assert "Arrows: larger errors." in picture.caption and "not in the catalogue" in picture.caption
    assert "pinching or slip" in picture.caption
    assert (
        "pinching with an error of 0.060, where the model as it was has 0.300, and a probability of 0.970"
        in picture.alt
    )


@pytest.mark.parametrize(("errors", "right"), [((0.2, 0.4, np.inf), 0.5), ((np.inf,), 1.25)])
def test_candidates_are_drawn_where_the_model_as_it_was_diverges(errors, right):
    names = ("pinching", "slip", "gap")
    candidates = [with_error(candidate(name, 1.0), error) for name, error in zip(names, errors, strict=False)]
    picture = ranking(replace(diagnosis(candidates), error=(0.3, np.inf)))
    (panel,) = picture.figure.axes
    assert_allclose(panel.get_xlim(), (0.0, right))
    assert "model as it was" not in panel.get_legend_handles_labels()[1] and "has diverged" in picture.alt


def test_hatched_bars_stand_in_a_page(tmp_path):
    found = diagnosis(
        [candidate("pinching", 800.0, 0.97), candidate("slip", 790.5, 0.03)], ["pinching"], [["pinching", "slip"]]
    )
    _, svg = style.save(ranking(found), tmp_path, "ranking")
    drawn = inline("ranking", svg.read_text(encoding="utf-8")).svg
    assert '<pattern id="ranking-' in drawn and "url(#ranking-" in drawn


def test_a_named_effect_never_carries_a_probability_of_nothing():
    picture = ranking(diagnosis([candidate("pinching", 4.0, 1e-7), candidate("slip", 3.0, 1e-7)], ["pinching"]))
    assert "by prediction" in texts(picture) and "< 0.001" in texts(picture)
    assert "probability of by prediction" not in picture.alt


def test_the_named_candidates_come_first_then_the_probable_ones_then_those_with_small_errors():
    names = [f"effect_{i}" for i in range(20)]
    many = [with_error(candidate(name, 0.0), 1.0 - 0.01 * i) for i, name in enumerate(names)]
    many[3] = candidate("effect_3", 0.0, 0.2)
    picture = ranking(diagnosis([candidate("named", 0.5), *many], ["named"]))
    (panel,) = picture.figure.axes
    shown = [tick.get_text() for tick in panel.get_yticklabels()]
    assert shown == ["named", "effect 3", *(f"effect {i}" for i in range(19, 9, -1))]
    assert "9 candidates that are less probable are not shown" in picture.caption


def test_the_words_and_numbers_of_a_posterior_of_many_parameters_do_not_cover_each_other():
    names = ("A", "beta", "yield_sharpness.delta", "slip.delta", "slip.width", "hardening.delta")
    figure = posterior(fitted(names, (4e7, 180.0, 0.4, 0.7, 0.7, 0.8)), None, {}).figure
    figure.draw_without_rendering()
    below = [panel.xaxis for panel in figure.axes[-len(names) :]]
    numbers = [
        t
        for a in below
        for t in a.get_ticklabels()
        if np.prod(np.subtract(t.get_position()[0], a.get_view_interval())) <= 0
    ]
    for texts in ([a.label for a in below], numbers):
        boxes = sorted((text.get_window_extent() for text in texts), key=lambda box: box.x0)
        assert len(boxes) >= len(names)
        assert all(one.x1 < other.x0 for one, other in pairwise(boxes))
        assert boxes[0].x0 > 0 and boxes[-1].x1 < figure.bbox.x1


def test_a_spring_that_softens_is_called_so_in_every_figure():
    steps = [Step([], 0.3, 0.4, {}), Step(["hardening"], 0.1, 0.2, {"hardening.delta": -0.25})]
    estimate = {"delta": {"mean": -0.25, "sd": 0.01, "q05": -0.27, "q95": -0.23, "unit": "1"}}
    softer = replace(candidate("hardening", 9.0, 0.9), estimate=estimate)
    for picture in (error_fall(Trail(steps, 0.04)), ranking(diagnosis([softer], ["hardening"]))):
        (panel,) = picture.figure.axes
        labels = [*panel.get_xticklabels(), *panel.get_yticklabels()]
        assert any("softening, as by P-Delta" in " ".join(label.get_text().split()) for label in labels)


def test_a_spring_that_softens_is_called_so_by_the_diagnosis_itself():
    estimate = {"delta": {"mean": -0.25, "sd": 0.01, "q05": -0.27, "q95": -0.23, "unit": "1"}}
    softer = replace(candidate("hardening", 9.0, 0.9), estimate=estimate, reason="it is a test")
    said = "hardening (softening, as by P-Delta)"
    named = diagnosis([softer, candidate("slip", 1.0)], ["hardening"])
    alike = diagnosis([softer, candidate("slip", 1.0)], ["slip"], [["slip", "hardening"]])
    for one in (named, alike, replace(alike, verdict="ambiguous"), replace(named, verdict="unexplained")):
        # In the sentence, which the report takes over, in the table and in the notes of the terminal.
        assert said in one.sentence and repr(one).count(said) >= 3 and one.summary()["sentence"] == one.sentence
    assert "softening" not in diagnosis([candidate("hardening", 9.0)], ["hardening"]).sentence


def test_the_staircase_is_the_trail():
    steps = [Step([], 0.3, 0.4, {}), Step(["gap"], 0.1, None, {}), Step(["gap", "mass_error"], 0.05, 0.06, {})]
    picture = error_fall(Trail(steps, 0.04))
    (panel,) = picture.figure.axes
    train, test = (patch for patch in panel.patches if patch.get_label().startswith("t"))
    assert_allclose(train.get_data().values, [0.3, 0.1, 0.05])
    assert_allclose(test.get_data().values, [0.4, np.nan, 0.06])
    (floor,) = panel.get_lines()
    assert_allclose(floor.get_ydata(), 0.04)
    assert [tick.get_text() for tick in panel.get_xticklabels()] == ["model as it was", "+ gap", "+ mass error"]
    assert {"train 0.300\ntest 0.400", "train 0.100", "train 0.050\ntest 0.060"} <= set(texts(picture))
    assert "noise floor 0.04" in picture.alt and "nan" not in picture.alt


def test_an_error_that_diverged_is_said_and_kept_off_the_axis():
    picture = error_fall(Trail([Step([], 0.3, 0.4, {}), Step(["gap"], 0.1, 1.3e8, {})], 0.04))
    (panel,) = picture.figure.axes
    assert panel.get_ylim()[1] < 1 and "train 0.100\ntest diverged" in texts(picture)


def test_without_held_out_experiments_there_is_one_staircase():
    (panel,) = error_fall(Trail([Step([], 0.3, None, {}), Step(["gap"], 0.1, None, {})], 0.0)).figure.axes
    assert [p.get_label() for p in panel.patches if p.get_label().startswith("t")] == ["train: fitted"]


def test_before_and_after_is_of_the_test_experiment_whose_error_fell_most():
    campaign, before, _ = histories(2, 3)
    after = improved(before, [0.09, 0.001, 0.05])
    picture = before_after(before, after, campaign)
    assert "E4 (test)" in texts(picture)
    loop, other, force, elongation = picture.figure.axes
    record = campaign["E4"].record
    measured, old, new = force.get_lines()
    assert_allclose(measured.get_ydata(), 1e-3 * record["force"])
    assert_allclose(old.get_ydata(), 1.1e-3 * record["force"])
    assert_allclose(new.get_ydata(), 1.001e-3 * record["force"])
    assert_allclose(elongation.get_lines()[2].get_ydata(), 1.001e3 * record["elongation"])
    assert_allclose(loop.get_lines()[1].get_xdata(), 1.1e3 * record["elongation"])
    assert_allclose(other.get_lines()[1].get_ydata(), 1.001e-3 * record["force"])
    errors = [
        np.sqrt(np.mean([v["nrmse"] ** 2 for v in c.test.per_experiment["E4"].values()])) for c in (before, after)
    ]
    assert {f"as it was: error {errors[0]:.3f}", f"improved: error {errors[1]:.3f}"} <= set(texts(picture))


@pytest.mark.parametrize(
    ("case", "panels"),
    [
        (lambda: histories(2, 0), 4),
        (lambda: histories(1, 1, outputs=("velocity_1",)), 1),
        (lambda: histories(1, 1, outputs=("force",), protocol="displacement", time=False, window=True), 3),
        (lambda: quantities(), 2),
        (lambda: quantities(1, 0), 2),
    ],
)
def test_before_and_after_of_any_comparison(case, panels):
    campaign, before, _ = case()
    picture = before_after(before, improved(before, [0.01] * 20), campaign)
    assert len(picture.figure.axes) == panels
    assert picture.caption.endswith(".") and "nan" not in picture.alt and "$" not in picture.alt + picture.caption


def test_quantities_are_scattered_before_and_after():
    campaign, before, _ = quantities()
    panel = before_after(before, improved(before, [0.02] * 20), campaign).figure.axes[0]
    lines = {line.get_label(): line for line in panel.get_lines()}
    assert set(lines) == {"as it was, train", "as it was, test", "improved, train", "improved, test", "equal"}
    measured = [1e-3 * e.quantities["peak_force"] for e in campaign.test.experiments]
    for name, factor in (("as it was, test", 1.1), ("improved, test", 1.02)):
        assert_allclose(lines[name].get_xdata(), measured)
        assert_allclose(lines[name].get_ydata(), factor * np.asarray(measured))


def test_intervals_of_the_parameters_in_the_unit_of_their_axis_with_the_truth():
    picture = parameters_before_after(POSTERIOR, IMPROVED, {"A": "N/m", "beta": "1/m"}, {"A": 5e5, "gap.delta": 1.0})
    first, second = picture.figure.axes
    assert (first.get_xlabel(), second.get_xlabel()) == ("A [kN/m]", "beta [1/m]")
    truth, *rest = first.get_lines()
    assert_allclose(truth.get_xdata(), 500)
    assert_allclose([line.get_xdata() for line in rest[::3]], [[390, 410], [490, 520]])
    assert_allclose([line.get_xdata()[0] for line in rest[2::3]], [400, 500])
    assert len(second.get_lines()) == 6
    assert "A 400 kN/m before, 500 kN/m after (true value 500 kN/m); beta 0.7 1/m before, 1 1/m after." in picture.alt
    assert parameters_before_after({}, IMPROVED, {}, {}) is None


def test_what_belongs_to_an_effect_is_none_of_the_law_even_a_users_own():
    told = {"mean": 1.0, "q05": 0.9, "q95": 1.1}
    both = {"storey1.k": told, "structure.mass_2": told, "storey1.bumper.delta": told}
    picture = parameters_before_after(both, both, {}, {}, {"storey1.bumper"})
    assert [name in picture.alt for name in both] == [True, True, False]


def test_what_there_is_material_for(monkeypatch):
    for name in ("ranking", "error_fall", "before_after", "parameters_before_after"):
        monkeypatch.setattr(diagnosis_figures, name, lambda *_, name=name: name)
    campaign, comparison, _ = histories()
    fit = fitted()
    cases = [
        ({}, []),
        ({"diagnosis": diagnosis([candidate("gap", 1.0)])}, ["ranking"]),
        ({"trail": Trail([Step([], 0.3, 0.3, {})], 0.1), "comparison": comparison, "fit": fit}, []),
        ({"trail": Trail([Step([], 0.3, 0.3, {})] * 2, 0.1)}, ["error_fall"]),
        ({"campaign": campaign, "comparison": comparison, "improved_comparison": comparison}, ["before_after"]),
        ({"fit": fit, "improved": fit}, ["parameters_before_after"]),
    ]
    for given, expected in cases:
        assert [name for name, _ in diagnosis_drawings(outcome(**given))] == expected


def test_the_table_of_the_ranking():
    table = _ranking(diagnosis([candidate("pinching", 800.0, 0.97), candidate("slip", 790.5, 0.03)], ["pinching"]))
    assert table["effect"].values.tolist() == ["pinching", "slip"]
    assert table["log_evidence_gain"].values.tolist() == [800.0, 790.5]
    assert table["named"].values.tolist() == [True, False]
    assert table["amplitude_q95"].values.tolist() == [0.6, 0.6]
    assert table.attrs == {"verdict": "missing_effects"}


@pytest.fixture(scope="module")
def docs():
    spec = importlib.util.spec_from_file_location("docs_effects", ROOT / "docs" / "effects.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_of_effects_is_up_to_date(docs):
    assert docs.PAGE.read_text(encoding="utf-8") == docs.page(), "run: python docs/effects.py"


def test_the_page_names_every_effect_and_each_has_a_small_figure(docs):
    text = docs.PAGE.read_text(encoding="utf-8")
    sizes = {path.stem: path.stat().st_size for path in docs.IMAGES.glob("*.png")}
    formed = {f"{name}_forms" for name, effect in docs.EFFECTS.items() if f"(images/effects/{name}_forms.png)" in text}
    assert sizes.keys() == docs.EFFECTS.keys() | formed and len(docs.EFFECTS) > 30 and len(formed) > 15
    assert max(sizes.values()) <= 40_000
    for name, effect in docs.EFFECTS.items():
        assert f"### {name}\n" in text and f"(images/effects/{name}.png)" in text
        assert effect.reference in text
    assert "`eta` = $\\delta_\\eta/E_c$ [1/J]" in text
    assert "`c2` = $\\delta_d\\thinspace F_c/v_c^{2}$ [N*s^2/m^2]" in text
    assert "`drift` = $\\delta_{\\dot 0}\\thinspace F_c\\thinspace v_c/(100\\thinspace u_c)$ [N/s]" in text
