"""The figures of a diagnosis and of the improved model: the candidates, the fall of the error, before and after."""

import textwrap
from collections.abc import Container, Mapping

import numpy as np
from matplotlib.axes import Axes

from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.improve import Step, Trail
from hsed_jax.criticism.prediction import Prediction, error_cell, has_diverged
from hsed_jax.diagnosis.findings import Candidate, Diagnosis
from hsed_jax.measurements import Campaign
from hsed_jax.physics import display
from hsed_jax.physics.effects import EFFECTS, called
from hsed_jax.physics.names import named, owner_of
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import style
from hsed_jax.reporting.misfit_figures import hysteresis_loops, line_of_equality, quantity_of, words_of_loop
from hsed_jax.reporting.probabilities import EXPLAINED
from hsed_jax.reporting.probabilities import shown as probability_text
from hsed_jax.reporting.style import Picture

_SHOWN = 12
# The longest bar of a candidate, relative to the error of the model as it was.
_CUT = 1.25
_90 = 1.6448536  # standard deviations on both sides hold 90 %
_DASHES = (0, (4, 1.6))
_PALE = "#9ecae1"
_BEFORE = {"color": style.RED, "linestyle": (0, (6, 1.2, 1, 1.2)), "linewidth": 0.9, "label": "model as it was",
           "zorder": 2}  # fmt: skip
_AFTER = {"color": style.BLUE, "linestyle": "-", "linewidth": 1.2, "label": "improved model", "zorder": 2.5}
_MEASURED = {**style.MEASURED, "label": "measured", "linewidth": 0.9}


@style.in_house_style
def ranking(diagnosis: Diagnosis) -> Picture:
    """The best candidates: the error of the model with each of them, and its probability.

    Named effects and similar effects are highlighted.

    Arguments:
        diagnosis: `ranking` with at least one candidate.
    """
    shown = _best(diagnosis)
    alike = {effect for group in diagnosis.look_alikes for effect in group} - set(diagnosis.effects)
    figure = style.new_figure(0.22 * len(shown) + 1.0)
    panel = figure.subplots()
    looks: dict[str, dict] = {
        "named": {"color": style.BLUE},
        "look-alike of a named effect": {
            "facecolor": _PALE,
            "edgecolor": style.BLUE,
            "hatch": "////",
            "linewidth": 0.5,
        },
        "other candidates": {"color": "#c8c8c8"},
    }
    kinds = [_kind(candidate, diagnosis, alike) for candidate in shown]
    places = -np.arange(len(shown), dtype=float)
    errors, (_, before) = np.asarray([candidate.error_test for candidate in shown]), diagnosis.error
    # Larger errors are cut: they would hide the other bars.  A model that diverges has no finite error.
    right = _CUT * next(
        error for error in (before, *np.sort(errors)[::-1], 1.0) if error > 0 and not has_diverged(error)
    )
    for kind, (text, look) in enumerate(looks.items()):
        own = [i for i, k in enumerate(kinds) if k == kind]
        if own:
            panel.barh(places[own], np.fmin(errors[own], right), height=0.68, label=text, **look)
    cut = ~(errors <= right)
    panel.plot(np.full(cut.sum(), right), places[cut], ">", color=style.DARK_GREY, ms=5, clip_on=False, zorder=3)
    panel.axvspan(0.0, diagnosis.noise_floor, color=style.GREY, alpha=0.3, linewidth=0, zorder=3, label="noise")
    if not has_diverged(before):
        panel.axvline(before, color=style.RED, linestyle=_DASHES, linewidth=1.2, label="model as it was")
    panel.set_xlim(0.0, right)
    panel.set_yticks(places, [style.words(c.called) for c in shown])
    panel.tick_params(axis="y", length=0)
    for tick, kind in zip(panel.get_yticklabels(), kinds, strict=True):
        tick.set_fontweight("bold" if kind == 0 else "normal")
    panel.grid(False, axis="y")
    panel.set_ylim(places[-1] - 0.6, 0.6)
    panel.set_xlabel("Normalised error with the candidate [–]")
    for place, *texts in [
        (0.9, "error", "probability"),
        *(
            (p, error_cell(c.error_test), probability_text(c.probability, c.effect in diagnosis.effects))
            for p, c in zip(places, shown, strict=True)
        ),
    ]:
        for text, offset in zip(texts, (48, 108), strict=True):
            panel.annotate(text, (1.0, place), xycoords=panel.get_yaxis_transform(),
                           xytext=(offset, 0), textcoords="offset points", ha="right", va="center", fontsize=8,
                           annotation_clip=False)  # fmt: skip
    style.legend(figure, panel)
    rest = len(diagnosis.ranking) - len(shown)
    groups = "; ".join(" or ".join(map(style.words, group)) for group in diagnosis.alternatives)
    first = shown[0]
    return Picture(
        figure,
        "Candidates for the missing effect: the normalised error of the best model with each candidate, on data that it was "
        f"not fitted to, and the probability of the candidate.  {EXPLAINED}"
        + ("  Arrows: larger errors." if cut.any() else "")
        + (f"  The measurements do not distinguish: {groups}." if groups else "")
        + (f"  {rest} candidates that are less probable are not shown." if rest else ""),
        f"{len(shown)} horizontal bars. Verdict: {diagnosis.verdict.replace('_', ' ')}. First is "
        f"{first.effect.replace('_', ' ')} with an error of {error_cell(first.error_test)}, where the model as it was has "
        f"{error_cell(before)}, and a probability of {probability_text(first.probability)}.",
    )


def _best(diagnosis: Diagnosis) -> list[Candidate]:
    """Named effects in their order, then the most probable ones; of equal probability, those with the smallest errors."""
    named = [c for c in diagnosis.ranking if c.effect in diagnosis.effects]
    others = [c for c in diagnosis.ranking if c not in named]
    others.sort(key=lambda c: (-round(c.probability, 3), c.error_test))
    return [*named, *others][: max(_SHOWN, len(named))]


def _kind(candidate: Candidate, diagnosis: Diagnosis, alike: set[str]) -> int:
    return 0 if candidate.effect in diagnosis.effects else 1 if candidate.effect in alike else 2


@style.in_house_style
def error_fall(trail: Trail) -> Picture:
    """The error after each added effect as a staircase, on the fitted and the held-out experiments, above the noise."""
    steps = trail.steps
    errors = np.asarray([[step.error_train, step.error_test] for step in steps], dtype=float)
    train, test = np.where(has_diverged(errors), np.nan, errors).T
    edges = np.arange(len(steps) + 1) - 0.5
    figure = style.new_figure(2.7)
    panel = figure.subplots()
    panel.axhspan(0.0, trail.noise_floor, color=style.GREY, alpha=0.18, linewidth=0)
    panel.stairs(train, edges, baseline=None, color=style.BLUE, linewidth=3.5, alpha=0.45, label="train: fitted")
    if np.isfinite(test).any():
        panel.stairs(test, edges, baseline=None, color=style.BLACK, linewidth=1.2, linestyle=_DASHES,
                     label="test: not fitted")  # fmt: skip
    panel.axhline(trail.noise_floor, color=style.DARK_GREY, linestyle=":", linewidth=1.3, zorder=1, label="noise floor")
    for place, (step, both) in enumerate(zip(steps, zip(train, test, strict=True), strict=True)):
        if texts := _errors_of(step):
            height = np.nanmax([*both, trail.noise_floor])  # a diverged model has no finite height
            panel.annotate("\n".join(texts), (place, height), xytext=(0, 4), textcoords="offset points", ha="center",
                           va="bottom", fontsize=8, linespacing=1.1)  # fmt: skip
    words = ["model as it was", *("+ " + style.words(called(s.effects[-1], s.parameters)) for s in steps[1:])]
    panel.set_xticks(range(len(steps)), ["\n".join(textwrap.wrap(word, 16)) for word in words])
    panel.tick_params(axis="x", length=0)
    panel.grid(False, axis="x")
    highest = np.nanmax([*train, *test, trail.noise_floor, 1e-9])
    panel.set(ylabel="Normalised error [–]", xlim=(edges[0], edges[-1]), ylim=(0.0, 1.28 * highest))
    style.legend(figure, panel)
    said = [f"{word}: {', '.join(_errors_of(step))}" for word, step in zip(words, steps, strict=True)]
    return Picture(
        figure,
        "Normalised error of the model as it was and after each added effect, on the experiments that were fitted and on "
        "those that were not fitted, against the error of the noise alone (shaded).",
        f"A falling staircase of {len(steps)} steps. {'; '.join(said)}; noise floor {style.amount(trail.noise_floor)}.",
    )


def _errors_of(step: Step) -> list[str]:
    """The known errors of a step, with the split."""
    both = (("train", step.error_train), ("test", step.error_test))
    return [f"{split} {error_cell(error)}" for split, error in both if error is not None and not np.isnan(error)]


@style.in_house_style
def before_after(before: Comparison, after: Comparison, campaign: Campaign) -> Picture | None:
    """The change by the added effects, in the experiment where it is largest.

    For histories, this is the experiment whose error fell most, of the test split if there is one: its hysteresis loop before
    and after, and its histories.  For quantities: predicted against measured, all experiments.

    Arguments:
        before, after: the first model and the improved one, compared with the same measurements.
        campaign: whether it has a time, and whether the elongation was imposed.

    Returns:
        The picture; None if no experiment of histories has errors.
    """
    if before.train_prediction.groups.size == len(before.train_prediction.outputs):
        return _scatter(before, after, campaign.pair)
    found = _most_improved(before, after)
    if found is None:
        return None
    split, id, old, new = found
    both, pair = [], campaign.pair
    for comparison in (before, after):
        prediction = dict((name, p) for name, _, p in comparison.splits())[split]
        both.append((prediction, [e.id for e in prediction.experiments].index(id)))
    (first, row), (second, other) = both
    names = first.outputs
    ours, theirs = (hysteresis_loops(prediction, index, campaign) for prediction, index in both)
    count = len(ours)
    figure = style.new_figure(2.7 * count + 1.45 * len(names) + 0.6)
    grid = figure.add_gridspec(len(names) + count, 2, height_ratios=[2.7] * count + [1.45] * len(names))
    panels: list[Axes] = []
    for line, owner in enumerate(ours):
        left = figure.add_subplot(grid[line, 0])
        beside = [left, figure.add_subplot(grid[line, 1], sharex=left, sharey=left)]
        _draw_loops(beside, owner, [ours[owner], theirs[owner]], pair)
        panels += beside
    for panel, text, error in zip(panels[:2], ("as it was", "improved"), (old, new), strict=False):
        panel.set_title(f"{text}: error {error:.3f}", loc="right")
    histories = [figure.add_subplot(grid[index + count, :]) for index in range(len(names))]
    for panel, name in zip(histories, names, strict=True):
        _history(panel, name, first, row, second, other, pair)
        panel.set_xlabel("Time [s]" if campaign.has_time else "Row")
    for panel in histories[:-1]:
        panel.set_xlabel("")
        panel.sharex(histories[-1])
        panel.tick_params(labelbottom=False)
    figure.align_ylabels([*panels[:1], *histories])
    panels += histories
    style.panel_titles(panels)
    style.legend(figure, *panels)
    figure.legends[0].set_title(style.plain(f"{id} ({split})", 90))
    which = id.replace("$", "")
    drawn = [f"{words_of_loop(owner)}, {text}" for owner in ours for text in ("as it was", "improved model")]
    drawn += map(pair.called, names)
    return Picture(
        figure,
        f"Experiment {which} ({split}), whose error fell most: measured (dashed), predicted by the model as it was "
        f"(dash-dotted) and by the improved model (continuous): {style.lettered(drawn)}."
        + ("" if first.experiments[row].window is None else "  Shaded: the part of the record that is scored."),
        f"{'Hysteresis loops and histories' if ours else 'Histories'} of {', '.join(names)}. The error is "
        f"{style.amount(old)} before and {style.amount(new)} after.",
    )


def _most_improved(before: Comparison, after: Comparison) -> tuple[str, str, float, float] | None:
    """Split, experiment, error before and after of the largest fall; of the test split if that has errors."""
    later = {name: split for name, split, _ in after.splits()}
    for name, split, _ in sorted(before.splits(), key=lambda entry: entry[0] != "test"):
        falls = []
        for id, errors in split.per_experiment.items():
            if name in later and id in later[name].per_experiment:
                pair = _error(errors), _error(later[name].per_experiment[id])
                if np.isfinite(pair).all():
                    falls.append((id, *pair))
        if falls:
            return name, *max(falls, key=lambda fall: fall[1] - fall[2])
    return None


def _error(outputs: Mapping[str, Mapping[str, float]]) -> float:
    """Error over the outputs of one experiment, averaged in the square."""
    return float(np.sqrt(np.mean([values["nrmse"] ** 2 for values in outputs.values()])))


def _draw_loops(panels: list[Axes], owner: str, loops: list[tuple[np.ndarray, ...]], pair: Pair) -> None:
    x, x_unit = display.shown(pair, named(owner, "elongation"), *(values for loop in loops for values in loop[::2]))
    y, y_unit = display.shown(pair, named(owner, "force"), *(values for loop in loops for values in loop[1::2]))
    for panel, (there, force, ours, predicted), look in zip(panels, loops, (_BEFORE, _AFTER), strict=True):
        panel.plot(there / x, force / y, **_MEASURED)
        panel.plot(ours / x, predicted / y, **look)
        panel.set_xlabel(style.channel_label(named(owner, "elongation"), x_unit, pair))
    panels[0].set_ylabel(style.channel_label(named(owner, "force"), y_unit, pair))
    panels[1].tick_params(labelleft=False)


def _history(panel: Axes, name: str, first: Prediction, row: int, second: Prediction, other: int, pair: Pair) -> None:
    record = first.experiments[row].record
    assert record is not None
    before, after = first.histories(row, name)[1], second.histories(other, name)[1]
    measured = style.recorded(panel, first, row, name)
    divisor, unit = display.shown(pair, name, measured, before, after)
    for values, look in ((measured, _MEASURED), (before, _BEFORE), (after, _AFTER)):
        panel.plot(record.time, values / divisor, **look)
    panel.margins(x=0.0)
    panel.set_ylabel(style.history_label(name, unit, pair))


def _scatter(before: Comparison, after: Comparison, pair: Pair) -> Picture:
    names = before.train_prediction.outputs
    figure, panels = style.panels(len(names), 3.0)
    said = []
    for panel, name in zip(panels, names, strict=True):
        known = [
            (look, split, quantity_of(prediction, name))
            for comparison, look in ((before, "as it was"), (after, "improved"))
            for split, _, prediction in comparison.splits()
        ]
        divisor, unit = display.shown(pair, name, *(v for *_, values in known for v in values[:2]))
        for look, split, values in known:
            measured, predicted, mean, sd = (v / divisor for v in values)
            colour, marker = (style.RED, "v") if look == "as it was" else (style.BLUE, "o")
            fill = colour if split == "train" else "white"
            panel.vlines(measured, mean - _90 * sd, mean + _90 * sd, color=colour, alpha=0.35, linewidth=0.9)
            panel.plot(measured, predicted, marker, ms=4.5, mfc=fill, mec=colour, mew=0.8, zorder=3,
                       label=f"{look}, {split}")  # fmt: skip
        line_of_equality(panel, [values for *_, values in known], divisor, style.channel_title(name, pair), unit)
        old, new = (one.train.per_output.get(name, {}).get("nrmse", np.nan) for one in (before, after))
        said.append(f"{pair.called(name)}: error {style.amount(old)} before, {style.amount(new)} after")
    style.panel_titles(panels)
    style.legend(figure, *panels)
    return Picture(
        figure,
        "Predicted against measured quantities with 90 % predictive bars, by the model as it was (triangles) and the "
        f"improved model (circles): {style.lettered([*map(pair.called, names)])}.  Filled: train; open: test.",
        f"Scatter plots beside the line of equality. {'; '.join(said)}.",
    )


@style.in_house_style
def parameters_before_after(
    before: Mapping[str, Mapping[str, float]],
    after: Mapping[str, Mapping[str, float]],
    units: Mapping[str, str],
    truth: Mapping[str, float],
    effects: Container[str] = EFFECTS,
) -> Picture | None:
    """Posterior means and 90 % intervals of the law's parameters, before and after effects were added.

    Arguments:
        before, after: `mean`, `q05` and `q95` by parameter, SI, as `Fit.summary` gives them.
        units: SI unit by parameter.
        truth: values of the virtual specimen if it exists, drawn as lines.
        effects: names of all effects; their parameters are left out.

    Returns:
        The picture; None where the two have no parameter of the law in common.
    """
    names = [name for name in before if name in after and owner_of(name) not in effects]
    if not names:
        return None
    figure, panels = style.panels(len(names), 1.25)
    said = []
    for panel, name in zip(panels, names, strict=True):
        true = truth.get(name)
        both = (before[name], after[name])
        ends = [s[key] for s in both for key in ("mean", "q05", "q95")]
        divisor, unit = display.readable(units.get(name, "1"), ends, [] if true is None else [true])
        if true is not None:
            panel.axvline(true / divisor, color=style.BLACK, linestyle=_DASHES, linewidth=1.1, label="true value")
        for place, s, look, marker in ((1, both[0], _BEFORE, "v"), (0, both[1], _AFTER, "o")):
            low, mean, high = (s[key] / divisor for key in ("q05", "mean", "q95"))
            panel.plot([low, high], [place, place], color=look["color"], linewidth=2.2, solid_capstyle="butt")
            panel.plot([low, high], [place, place], "|", color=look["color"], ms=8)
            panel.plot(mean, place, marker, color=look["color"], ms=6, mec="white", mew=0.6, zorder=4)
        panel.set_yticks([1, 0], ["as it was", "improved"])
        panel.tick_params(axis="y", length=0)
        panel.grid(False, axis="y")
        panel.margins(x=0.12)
        panel.set(xlabel=style.label(name, unit), ylim=(-0.6, 1.6))
        means = [style.amount(s["mean"] / divisor, unit) for s in both]
        known = "" if true is None else f" (true value {style.amount(true / divisor, unit)})"
        said.append(f"{name} {means[0]} before, {means[1]} after{known}")
    style.panel_titles(panels)
    style.legend(figure, *panels)
    has_truth = any(name in truth for name in names)
    return Picture(
        figure,
        "Parameters of the law in the model as it was and in the improved one, posterior mean and 90 % interval: "
        + style.lettered(names)
        + (".  Dashed: true value of the virtual specimen." if has_truth else "."),
        f"Two intervals per parameter. {'; '.join(said)}.",
    )
