"""The figures of the misfit between measured and predicted: each experiment, all quantities, and a table."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.locate import Location
from hsed_jax.criticism.prediction import Prediction, error_cell
from hsed_jax.measurements import Campaign
from hsed_jax.physics import display
from hsed_jax.physics.names import named, own_name, owner_of
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import style
from hsed_jax.reporting.band_figures import band_parts
from hsed_jax.reporting.misfit_maps import error_map, residual_coordinates
from hsed_jax.reporting.style import Drawing, Picture

_OVERLAYS = 6
_LOOPS = 9
_ROWS = 25
_90 = 1.6448536  # standard deviations on both sides hold 90 %
_BAND = {"color": style.BLUE, "alpha": 0.2, "linewidth": 0, "label": "90 % predictive band", "zorder": 1}
_COLUMNS: dict[str, tuple[str, float, str]] = {
    "nrmse": ("error", 1, "{:.3f}"),
    "noise_floor": ("noise", 1, "{:.3f}"),
    "bias": ("bias", 1, "{:+.3f}"),
    "peak_error": ("peak", 100, "{:+.1f} %"),
    "energy_error": ("energy", 100, "{:.1f} %"),
    "coverage_90": ("coverage", 100, "{:.0f} %"),
}


def misfit_drawings(
    comparison: Comparison, location: Location | None, errors_over_inputs: xr.Dataset | None, campaign: Campaign
) -> Iterator[Drawing]:
    """Every figure of the misfit that has data.

    Arguments:
        comparison: a calibrated model against its measurements.
        location: where the misfit is.
        errors_over_inputs: as `hsed_jax.criticism.error_map` gives it.
        campaign: the experiments compared.
    """
    for _, split, prediction in comparison.splits():
        if prediction.groups.size == len(prediction.outputs):
            continue
        errors = split.per_experiment
        worst = sorted(errors, key=lambda id: -max(badness(values) for values in errors[id].values()))[:_OVERLAYS]
        for row, experiment in enumerate(prediction.experiments):
            if experiment.id in worst and experiment.record is not None:
                yield f"overlay_{experiment.id}", partial(overlay, prediction, row, errors[experiment.id], campaign)
    if comparison.train_prediction.groups.size == len(comparison.train_prediction.outputs):
        yield "measured_against_predicted", partial(measured_against_predicted, comparison, campaign)
    yield "band_parts", partial(band_parts, comparison, campaign)
    if location is not None:
        yield "residual_coordinates", partial(residual_coordinates, location, campaign)
    if errors_over_inputs is not None:
        yield "error_map", partial(error_map, errors_over_inputs)
    yield "error_table", partial(error_table, comparison, campaign)


@style.in_house_style
def overlay(prediction: Prediction, row: int, errors: Mapping[str, Mapping[str, float]], campaign: Campaign) -> Picture:
    """One experiment: every output over time, measured and predicted with its band, and the loop where it is known.

    Arguments:
        prediction: of histories.
        row: of the experiment in it.
        errors: of the experiment, by output.
        campaign: whether it has a time, and whether the elongation was imposed.
    """
    experiment, pair = prediction.experiments[row], campaign.pair
    assert experiment.record is not None
    count, loops = len(prediction.outputs), hysteresis_loops(prediction, row, campaign)
    figure = style.new_figure(max(1.7 * count, 2.4) + 0.5)
    grid = figure.add_gridspec(count, 2 if loops else 1, width_ratios=(1.7, 1) if loops else None)
    panels = [figure.add_subplot(grid[index, 0]) for index in range(count)]
    for panel, name in zip(panels, prediction.outputs, strict=True):
        _history(panel, prediction, row, name, pair)
        panel.set_xlabel("Time [s]" if campaign.has_time else "Row")
        if name in errors:
            panel.set_title(f"error {error_cell(errors[name]['nrmse'])}", loc="right")
    for panel in panels[:-1]:
        panel.set_xlabel("")
        panel.sharex(panels[-1])
        panel.tick_params(labelbottom=False)
    figure.align_ylabels(panels)
    for number, (owner, loop) in enumerate(loops.items()):
        rows = slice(number * count // len(loops), (number + 1) * count // len(loops)) if owner else slice(0, 2)
        panels.append(figure.add_subplot(grid[rows, 1]))
        _draw_loop(panels[-1], owner, loop, pair)
    failed = ", simulation diverged" if prediction.diverged[row] else ""
    style.panel_titles(panels)
    style.legend(figure, *panels)
    figure.legends[0].set_title(style.plain(f"{experiment.id} ({experiment.split}{failed})", 90))
    said = "; ".join(f"{pair.called(name)}: error {style.amount(values['nrmse'])}" for name, values in errors.items())
    which, names = experiment.id.replace("$", ""), [*map(pair.called, prediction.outputs)]
    return Picture(
        figure,
        f"Experiment {which} ({experiment.split}{failed}), measured (dashed) and predicted at the MAP (continuous) with the 90 % "
        f"predictive band: {style.lettered([*names, *map(words_of_loop, loops)])}."
        + ("" if experiment.window is None else "  Shaded: the part of the record that is scored."),
        f"Histories of {', '.join(names)}{' and the hysteresis loop' if loops else ''}. {said}.",
    )


def _history(panel: Axes, prediction: Prediction, row: int, name: str, pair: Pair) -> None:
    record = prediction.experiments[row].record
    assert record is not None
    _, predicted, mean, sd = prediction.histories(row, name)
    measured, time = style.recorded(panel, prediction, row, name), record.time
    divisor, unit = display.shown(pair, name, measured, predicted)
    panel.fill_between(time, (mean - _90 * sd) / divisor, (mean + _90 * sd) / divisor, **_BAND)
    panel.plot(time, measured / divisor, **{**style.MEASURED, "label": "measured"})
    panel.plot(time, predicted / divisor, **{**style.PREDICTED, "label": "predicted"})
    panel.margins(x=0.0)
    panel.set_ylabel(style.history_label(name, unit, pair))


def hysteresis_loops(prediction: Prediction, row: int, campaign: Campaign) -> dict[str, tuple[np.ndarray, ...]]:
    """By specimen, measured elongation and force, then predicted, where scored; those where both are known."""
    record, found = prediction.experiments[row].record, {}
    forces = [name for name in prediction.outputs if own_name(name) == "force"]
    for name in forces if record is not None else ():
        assert record is not None
        owner = owner_of(name)
        along = named(owner, "elongation")
        force, predicted, _, _ = prediction.histories(row, name)
        if along in prediction.outputs:
            there, ours, _, _ = prediction.histories(row, along)
        elif campaign.protocol == "displacement" and along in record.channels:
            there = ours = record[along]
        else:
            continue
        scored = prediction.used[row, prediction.columns(name)][: len(record)]
        found[owner] = tuple(np.where(scored, channel, np.nan) for channel in (there, force, ours, predicted))
    return found


def words_of_loop(owner: str) -> str:
    """The name of a specimen's loop in a caption."""
    return f"hysteresis loop of {style.words(owner)}" if owner else "hysteresis loop"


def _draw_loop(panel: Axes, owner: str, loop: tuple[np.ndarray, ...], pair: Pair) -> None:
    there, force, ours, predicted = loop
    x, x_unit = display.shown(pair, named(owner, "elongation"), there, ours)
    y, y_unit = display.shown(pair, named(owner, "force"), force, predicted)
    panel.plot(there / x, force / y, **{**style.MEASURED, "label": "measured", "linewidth": 0.8})
    panel.plot(ours / x, predicted / y, **{**style.PREDICTED, "label": "predicted", "linewidth": 0.9})
    panel.set_xlabel(style.channel_label(named(owner, "elongation"), x_unit, pair))
    panel.set_ylabel(style.channel_label(named(owner, "force"), y_unit, pair))


@style.in_house_style
def loops(comparison: Comparison, campaign: Campaign) -> Picture | None:
    """The hysteresis loops of the experiments, measured and predicted, those with the largest errors first.

    Arguments:
        comparison: of histories; of more than nine experiments the worst nine are shown.
        campaign: whether the elongation was imposed.

    Returns:
        The picture; None where force and elongation are not both known.
    """
    found = []
    for name, part, prediction in comparison.splits():
        for row, experiment in enumerate(prediction.experiments):
            if experiment.id not in part.per_experiment:
                continue
            for owner, loop in hysteresis_loops(prediction, row, campaign).items():
                error = badness(part.per_experiment[experiment.id][named(owner, "force")])
                found.append((error, f"{experiment.id} ({name})", owner, loop))
    if not found:
        return None
    found.sort(key=lambda entry: -entry[0])
    shown = found[:_LOOPS]
    figure, panels = style.panels(len(shown), 2.3, across=3)
    for panel, (error, who, owner, loop) in zip(panels, shown, strict=True):
        _draw_loop(panel, owner, loop, campaign.pair)
        panel.set_title(style.plain(who, 20), loc="left")
        panel.set_title(f"error {error_cell(error)}", loc="right")
    style.legend(figure, panels[0])
    rest = len(found) - len(shown)
    return Picture(
        figure,
        f"Hysteresis loops, measured (dashed) and predicted (continuous), the largest error of the {campaign.pair.force} first."
        + (f"  {rest} more are not shown." if rest else ""),
        f"{len(shown)} loops. Largest error {style.amount(shown[0][0])} in {shown[0][1].replace('$', '')}, smallest shown "
        f"{style.amount(shown[-1][0])} in {shown[-1][1].replace('$', '')}.",
    )


@style.in_house_style
def measured_against_predicted(comparison: Comparison, campaign: Campaign) -> Picture:
    """A panel per quantity: predicted against measured with 90 % predictive bars, the line of equality between."""
    names, pair = comparison.train_prediction.outputs, campaign.pair
    figure, panels = style.panels(len(names), 3.0)
    said = []
    for panel, name in zip(panels, names, strict=True):
        known = {split: quantity_of(prediction, name) for split, _, prediction in comparison.splits()}
        divisor, unit = display.shown(pair, name, *(v for values in known.values() for v in values[:2]))
        for split, values in known.items():
            measured, predicted, mean, sd = (v / divisor for v in values)
            fill = style.BLUE if split == "train" else "white"
            panel.vlines(measured, mean - _90 * sd, mean + _90 * sd, color=style.BLUE, alpha=0.5, linewidth=0.9)
            panel.plot(measured, predicted, "o", ms=4.5, mfc=fill, mec=style.BLUE, zorder=3, label=split)
            said.append(
                f"{pair.called(name)}, {split}: {measured.size} experiments, largest {style.peak(measured, unit)}"
            )
        line_of_equality(panel, list(known.values()), divisor, style.channel_title(name, pair), unit)
    style.panel_titles(panels)
    style.legend(figure, *panels)
    return Picture(
        figure,
        "Predicted against measured quantities with 90 % predictive bars: "
        f"{style.lettered([*map(pair.called, names)])}.  Filled: train; open: test.",
        f"Scatter plots beside the line of equality. {'; '.join(said)}.",
    )


def quantity_of(prediction: Prediction, name: str) -> list[np.ndarray]:
    """Measured, predicted, predictive mean and sd of a quantity where it was measured."""
    column = int(np.flatnonzero(prediction.columns(name))[0])
    used = prediction.used[:, column]
    tables = (prediction.measured, prediction.shown, prediction.mean, prediction.sd)
    return [table[used, column] for table in tables]


def line_of_equality(panel: Axes, known: Sequence[Sequence[np.ndarray]], divisor: float, title: str, unit: str) -> None:
    """The line between all that is measured and predicted (`quantity_of`), and the titles of the axes."""
    both = np.concatenate([v for values in known for v in values[:2]]) / divisor
    both = both[np.isfinite(both)]
    ends = [float(both.min(initial=np.inf)), float(both.max(initial=-np.inf))] if both.size else [0.0, 1.0]
    panel.plot(ends, ends, color=style.BLACK, linewidth=0.8, zorder=1, label="equal")
    panel.set(xlabel=f"{title}, measured [{style.unit_text(unit)}]", ylabel=f"predicted [{style.unit_text(unit)}]")


@style.in_house_style
def error_table(comparison: Comparison, campaign: Campaign) -> Picture | None:
    """The errors of each experiment and output, worst first; None if no experiment has errors."""
    found = [
        (id, name, output, values)
        for name, split, _ in comparison.splits()
        for id, outputs in split.per_experiment.items()
        for output, values in outputs.items()
    ]
    if not found:
        return None
    found.sort(key=lambda entry: -badness(entry[3]))
    shown = found[:_ROWS]
    columns = {key: look for key, look in _COLUMNS.items() if any(key in values for *_, values in shown)}
    cells = [
        [
            style.plain(id, 28),
            split,
            campaign.pair.called(name),
            *(_cell(values.get(key, np.nan), factor, look) for key, (_, factor, look) in columns.items()),
        ]
        for id, split, name, values in shown
    ]
    heads = ["experiment", "split", "output", *(head for head, *_ in columns.values())]
    widths = np.asarray([max(len(row[i]) for row in [heads, *cells]) + 2 for i in range(len(heads))], dtype=float)
    figure = style.new_figure(0.21 * (len(cells) + 1) + 0.15)
    panel = figure.subplots()
    panel.set_axis_off()
    table = panel.table(cells, colLabels=heads, colWidths=list(widths / widths.sum()), cellLoc="right",
        colLoc="right",
                        bbox=Bbox.unit(), edges="horizontal")  # fmt: skip
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    for (row, column), cell in table.get_celld().items():
        cell.set_edgecolor("#d0d0d0")
        cell.set_linewidth(0.5)
        if column < 3:
            cell.set_text_props(ha="left")
        if row == 0:
            cell.set_text_props(weight="bold")
    rest = len(found) - len(shown)
    return Picture(
        figure,
        "Errors of each experiment, worst first: RMS residual over RMS of the measurement, the same for the noise, mean "
        "residual over that RMS, error of the peak and of the energy per cycle, coverage of the 90 % band."
        + (f"  {rest} more are not shown." if rest else ""),
        f"A table of {len(shown)} rows. Largest error {style.amount(shown[0][3]['nrmse'])} in "
        f"{shown[0][0].replace('$', '')}.",
    )


def _cell(value: float, factor: float, look: str) -> str:
    if np.isinf(value):
        return "diverged"
    return look.format(factor * value).replace("-", "−") if np.isfinite(value) else "–"


def badness(values: Mapping[str, float]) -> float:
    """The error, largest if it is not a number."""
    return values["nrmse"] if np.isfinite(values["nrmse"]) else np.inf
