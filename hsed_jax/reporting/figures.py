"""The figures of a study, numbered as in Abbiati & Marelli.

Each function takes plain arrays in SI units and returns a `Picture`: the figure, its caption, and its content in a sentence
for readers who cannot see it.  These functions read no files and do not change the global state of matplotlib.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from hsed_jax.physics import display
from hsed_jax.physics.outputs import output
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture as Picture

History = Mapping[str, npt.ArrayLike]
"""Channels of one experiment by canonical name, and `time` [s]; all of shape (m,), in SI units."""

_MANY_POINTS = 50_000
_SERIES = {"color": style.BLUE, "marker": "o", "linewidth": 1.1}


@style.in_house_style
def ground_motions(
    time: npt.ArrayLike,
    accelerations: npt.ArrayLike,
    central: npt.ArrayLike,
    periods: npt.ArrayLike,
    spectra: npt.ArrayLike,
    central_spectrum: npt.ArrayLike,
    damping_ratio: float = 0.05,
) -> Picture:
    """Fig. 3: random ground motions and their response spectra in grey, the motion at the central inputs in red.

    Arguments:
        time: [s], shape (m,).
        accelerations: realisations [m/s²], shape (n, m).
        central: the motion at the central inputs [m/s²], shape (m,).
        periods: natural periods [s], shape (k,).
        spectra: pseudo-acceleration of the realisations [m/s²], shape (n, k).
        central_spectrum: of the central motion [m/s²], shape (k,).
        damping_ratio: of the spectra.
    """
    count = len(np.asarray(accelerations))
    figure = style.new_figure(2.9)
    left, right = figure.subplots(1, 2)
    for panel, x, realisations, one in (
        (left, time, accelerations, central),
        (right, periods, spectra, central_spectrum),
    ):
        x, realisations = np.asarray(x), np.asarray(realisations)
        curves = LineCollection(
            [np.column_stack([x, y]) for y in realisations],
            colors=style.DARK_GREY,
            linewidths=0.5,
            alpha=min(1.0, max(0.08, 30 / max(count, 1))),  # many curves show their density
            rasterized=realisations.size > _MANY_POINTS,  # viewers cannot open an SVG with a million vertices
        )
        panel.add_collection(curves)
        panel.plot([], [], color=style.GREY, label=f"{count} random realisations")
        panel.plot(x, one, color=style.RED, linewidth=1.8, label="central inputs")
        panel.margins(x=0.0)
    left.set(xlabel="Time [s]", ylabel=style.channel_label("ground_acceleration", "m/s^2"))
    right.set(xlabel="Period $T$ [s]", ylabel=f"Pseudo-acceleration $S_a$ [{style.unit_text('m/s^2')}]")
    right.set_ylim(bottom=0.0)
    style.panel_titles((left, right))
    style.legend(figure, left)
    return Picture(
        figure,
        f"Ground motions: a) accelerations, b) elastic response spectra at {100 * damping_ratio:g} % damping.  "
        f"Grey: {count} random realisations of the inputs; red: central inputs.",
        f"Two panels of curves. Largest ground acceleration: {style.peak(central, 'm/s²')} at the central inputs, "
        f"{style.peak(accelerations, 'm/s²')} among {count} realisations. Largest pseudo-acceleration: "
        f"{style.peak(central_spectrum, 'm/s²')} at the central inputs, {style.peak(spectra, 'm/s²')} among them.",
    )


@style.in_house_style
def loops_and_energy(measured: History, predicted: History) -> Picture:
    """Fig. 4: one experiment, measured (dashed) and predicted (continuous): force against elongation, energy over time.

    Arguments:
        measured, predicted: `time`, `elongation`, `force`, `energy`; a missing channel is not drawn.
    """
    figure = style.new_figure(3.0)
    left, right = figure.subplots(1, 2)
    _compare(left, "elongation", "force", measured, predicted)
    _compare(right, "time", "energy", measured, predicted)
    style.panel_titles((left, right))
    style.legend(figure, left)
    return Picture(
        figure,
        "Measured (HS, dashed) and predicted (CS, continuous) response of the specimen: a) hysteresis loop, "
        "b) dissipated energy.",
        f"Two panels. {_peaks_in_words(measured, predicted)}",
    )


@style.in_house_style
def estimate_maps(
    grid_inputs: tuple[npt.ArrayLike, npt.ArrayLike],
    values: npt.ArrayLike,
    names: Sequence[str],
    units: Sequence[str],
    input_labels: Mapping[str, str],
) -> Picture:
    """Fig. 4bis: the estimate of each parameter from one experiment alone, over two inputs.

    Arguments:
        grid_inputs: values of the two inputs, shapes (a,) and (b,), each increasing.
        values: MAP estimates, shape (p, a, b); NaN without one.
        names, units: of the p parameters.
        input_labels: unit by name of the two inputs, in the order of `grid_inputs`.
    """
    x, y = (np.atleast_1d(np.asarray(grid, dtype=float)) for grid in grid_inputs)
    values = np.asarray(values, dtype=float)
    (x_name, x_unit), (y_name, y_unit) = input_labels.items()
    figure, panels = style.panels(len(names), 2.8)
    said = []
    for panel, estimate, name, unit in zip(panels, values, names, units, strict=True):
        divisor, unit = display.readable(unit, estimate)
        shown = np.ma.masked_invalid(estimate / divisor)
        _filled_contours(figure, panel, x, y, shown, style.label(name, unit))
        panel.set(xlabel=style.label(x_name, x_unit), ylabel=style.label(y_name, y_unit))
        # The extremes of an empty array are `masked`, which is not a number.
        low, high = (style.amount(float(np.ma.filled(v, np.nan)), unit) for v in (shown.min(), shown.max()))
        said.append(f"{name} between {low} and {high}")
    style.panel_titles(panels)
    return Picture(
        figure,
        "MAP estimates of the parameters from a single experiment, over the domain of the inputs: "
        + style.lettered(names)
        + ".  A correct model would give the same estimate everywhere.",
        f"Contour maps over {x_name} and {y_name}: {'; '.join(said)}.",
    )


@style.in_house_style
def expected_improvement_history(values: npt.ArrayLike) -> Picture:
    """Fig. 5: the largest expected improvement at each iteration, shape (n,) [–]."""
    values = np.asarray(values, dtype=float)
    figure = style.new_figure(2.6)
    panel = figure.subplots()
    panel.plot(np.arange(1, values.size + 1), values, **_SERIES, clip_on=False)
    if np.nanmin(values, initial=0.0) >= 0:
        panel.set_ylim(bottom=0.0)
    panel.set(xlabel="Iteration", ylabel=r"$\max_x\, E[I(x)]$ [–]")
    style.whole_numbers(panel.xaxis)
    finite = [style.amount(value) for value in values[np.isfinite(values)]]
    ends = f"from {finite[0]} to {finite[-1]}" if finite else "without a finite value"
    return Picture(
        figure,
        "Largest expected improvement of the discrepancy at each iteration.",
        f"One curve over the iterations, {values.size} in all, {ends}.",
    )


@style.in_house_style
def exploration_order(inputs: npt.ArrayLike, initial: int, bounds: npt.ArrayLike, labels: Mapping[str, str]) -> Picture:
    """Fig. 6: when each region of the inputs was explored, 0 for the first experiment and 1 for the last.

    Two inputs are shown as a map, a weighted mean of the order of the nearby experiments, and the experiments are
    numbered on it; one input as a line of experiments; more as a matrix of pairs without a map.

    Arguments:
        inputs: experiments in the order performed, shape (n, d).
        initial: how many of them were the initial design.
        bounds: lower and upper bound of each input, shape (d, 2).
        labels: unit by name of the d inputs.
    """
    inputs, bounds = np.asarray(inputs, dtype=float), np.asarray(bounds, dtype=float)
    count, dimension = inputs.shape
    axes = [style.label(name, unit) for name, unit in labels.items()]
    if dimension == 1:
        figure, what = _order_along_a_line(inputs[:, 0], initial, bounds[0], axes[0]), "Order of the experiments"
    elif dimension == 2:
        figure, what = _order_over_a_plane(inputs, initial, bounds, axes), "Order of the explored regions"
    else:
        figure, what = _order_over_pairs(inputs, initial, bounds, axes), "Order of the experiments, by pairs of inputs"
    return Picture(
        figure,
        f"{what}: 0 first, 1 last.  Squares: initial design; circles: experiments chosen one after another.",
        f"{count} experiments over {', '.join(labels)}, the first {min(initial, count)} of them the initial design.",
    )


@style.in_house_style
def estimate_history(
    estimates: npt.ArrayLike,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    names: Sequence[str],
    units: Sequence[str],
    references: Mapping[str, float] | None = None,
) -> Picture:
    """Fig. 7: MAP estimates at each iteration with their 90 % credible band.

    Arguments:
        estimates, lower, upper: shape (n, p), NaN without one.
        names, units: of the p parameters.
        references: true or published values of some of them, drawn as a line.
    """
    estimates, lower, upper = (np.asarray(v, dtype=float) for v in (estimates, lower, upper))
    references = references or {}
    iterations = np.arange(1, len(estimates) + 1)
    figure, panels = style.panels(len(names), 2.4)
    said = []
    for index, (panel, name, unit) in enumerate(zip(panels, names, units, strict=True)):
        reference = references.get(name)
        middle, low, high = (v[:, index] for v in (estimates, lower, upper))
        divisor, unit = display.readable(unit, middle, [] if reference is None else [reference])
        middle, low, high = middle / divisor, low / divisor, high / divisor
        panel.fill_between(iterations, low, high, color=style.BLUE, alpha=0.2, linewidth=0, label="90 % credible band")
        # The band has no width where its neighbours are missing.
        known = np.pad(np.isfinite(low + high), 1)
        alone = known[1:-1] & ~known[:-2] & ~known[2:]
        panel.vlines(iterations[alone], low[alone], high[alone], color=style.BLUE, alpha=0.2, linewidth=6)
        panel.plot(iterations, middle, **_SERIES, label="MAP estimate")
        last = middle[np.isfinite(middle)][-1:]
        said.append(f"{name} ends at {style.amount(*last, unit=unit) if last.size else 'no value'}")
        if reference is not None:
            panel.axhline(reference / divisor, color=style.BLACK, linestyle=(0, (4, 1.6)), label="reference")
            said[-1] += f" (reference {style.amount(reference / divisor, unit)})"
        panel.set(xlabel="Iteration", ylabel=style.label(name, unit))
        style.whole_numbers(panel.xaxis)
    style.panel_titles(panels)
    style.legend(figure, *panels)
    return Picture(
        figure,
        "MAP estimates of the parameters at each iteration, with 90 % credible bands: "
        + style.lettered(names)
        + (".  Dashed: reference." if references else "."),
        f"Estimates over the iterations, {len(estimates)} in all: {'; '.join(said)}.",
    )


@style.in_house_style
def response_comparison(cases: Sequence[tuple[str, History, History]]) -> Picture:
    """Fig. 8: measured (dashed) and predicted (continuous) force, elongation and energy over time.

    Arguments:
        cases: one column each: its title, the measured and the predicted channels (`time`, `force`, `elongation`,
            `energy`; a missing one is not drawn).
    """
    channels = ("force", "elongation", "energy")
    figure = style.new_figure(5.6)
    grid = figure.subplots(len(channels), len(cases), squeeze=False, sharex="col", sharey="row")
    everything = [history for _, *pair in cases for history in pair]
    for row, channel in zip(grid, channels, strict=True):
        for panel, (_, measured, predicted) in zip(row, cases, strict=True):
            _compare(panel, "time", channel, measured, predicted, scaled_with=everything)
            panel.label_outer()
    for panel, (title, _, _) in zip(grid[0], cases, strict=True):
        panel.set_title(title)
    style.panel_titles(grid[:, 0])
    figure.align_ylabels(grid[:, 0])
    style.legend(figure, grid[0, 0])
    return Picture(
        figure,
        "Measured (HS, dashed) and predicted (CS, continuous) response of the specimen over time: "
        "a) restoring force, b) elongation, c) dissipated energy.",
        " ".join(
            f"{title.replace('$', '')}: {_peaks_in_words(measured, predicted)}" for title, measured, predicted in cases
        ),
    )


def _compare(
    panel: Axes, x: str, y: str, measured: History, predicted: History, scaled_with: Sequence[History] = ()
) -> None:
    """Channel `y` against `x`, measured and predicted, in the unit that suits all of `scaled_with`."""
    scales = {"time": (1.0, "s")}
    for channel in {x, y} - {"time"}:
        shown = [history[channel] for history in scaled_with or (measured, predicted) if channel in history]
        scales[channel] = display.readable(output(channel).unit, *shown)
    for history, look in ((measured, style.MEASURED), (predicted, style.PREDICTED)):
        if x in history and y in history:
            panel.plot(np.asarray(history[x]) / scales[x][0], np.asarray(history[y]) / scales[y][0], **look)
    panel.set_xlabel("Time [s]" if x == "time" else style.channel_label(x, scales[x][1]))
    panel.set_ylabel(style.channel_label(y, scales[y][1]))
    if x == "time":
        panel.margins(x=0.0)


def _peaks_in_words(measured: History, predicted: History) -> str:
    said = []
    for channel, what in (("force", "Largest force"), ("elongation", "largest elongation"), ("energy", "final energy")):
        both = [np.asarray(history[channel]) for history in (measured, predicted) if channel in history]
        if len(both) == 2:
            divisor, unit = display.readable(output(channel).unit, *both)
            m, p = (style.peak((values[-1:] if channel == "energy" else values) / divisor, unit) for values in both)
            said.append(f"{what} {m} measured, {p} predicted")
    return "; ".join(said) + "."


def _filled_contours(
    figure: Figure, panel: Axes, x: np.ndarray, y: np.ndarray, values: np.ma.MaskedArray, label: str
) -> None:
    """A contour map with its colour bar, and squares where contours cannot reach: beside gaps, on a grid of one row."""
    levels = style.levels(values)
    is_grid = min(values.shape) > 1
    if not is_grid or np.ma.is_masked(values):
        points, norm = np.meshgrid(x, y, indexing="ij"), Normalize(levels[0], levels[-1])
        mappable = panel.scatter(*points, c=values, marker="s", s=16, cmap=style.COLOUR_MAP, norm=norm, zorder=0.5)
    if is_grid:
        mappable = panel.contourf(x, y, values.T, levels, cmap=style.COLOUR_MAP)
        panel.contour(x, y, values.T, levels, colors=style.BLACK, linewidths=0.4)
    panel.grid(False)
    figure.colorbar(mappable, ax=panel, label=label)


def _order_along_a_line(inputs: np.ndarray, initial: int, bounds: np.ndarray, axis: str) -> Figure:
    figure = style.new_figure(3.0)
    panel = figure.subplots()
    experiments = np.arange(1, len(inputs) + 1)
    panel.plot(inputs, experiments, color=style.GREY, linewidth=0.8, zorder=1)
    for marker, part in (("s", slice(None, initial)), ("o", slice(initial, None))):
        panel.plot(inputs[part], experiments[part], marker, ms=5, mfc="white", mec=style.BLACK, mew=0.7)
    panel.set(xlabel=axis, ylabel="Experiment", xlim=_around(bounds))
    style.whole_numbers(panel.yaxis)
    _order_legend(figure, panel, None)
    return figure


def _order_over_a_plane(inputs: np.ndarray, initial: int, bounds: np.ndarray, axes: list[str]) -> Figure:
    figure = style.new_figure(4.6)
    panel = figure.subplots()
    x, y = (np.linspace(low, high, 121) for low, high in bounds)
    filled = panel.contourf(x, y, _smooth_order(inputs, bounds, x, y), np.linspace(0, 1, 11), cmap=style.COLOUR_MAP)
    for index, (u, v) in enumerate(inputs):
        # Each number belongs to its marker: if two overlap, the later one is complete.
        marker, layer = "s" if index < initial else "o", 3 + index / len(inputs)
        panel.plot(u, v, marker, ms=9, mfc="white", mec=style.BLACK, mew=0.7, zorder=layer, clip_on=False)
        panel.annotate(str(index + 1), (u, v), ha="center", va="center_baseline", fontsize=6, zorder=layer)
    panel.set(xlabel=axes[0], ylabel=axes[1], xlim=bounds[0], ylim=bounds[1])
    panel.grid(False)
    _order_legend(figure, panel, filled)
    return figure


def _order_over_pairs(inputs: np.ndarray, initial: int, bounds: np.ndarray, axes: list[str]) -> Figure:
    size = len(axes) - 1
    figure = style.new_figure(min(1.0 + 2.0 * size, 9.0))
    grid = figure.subplots(size, size, squeeze=False, sharex="col", sharey="row")
    colours = ScalarMappable(Normalize(0, 1), style.COLOUR_MAP)
    shades = colours.to_rgba(_order(len(inputs)))
    for column, row in combinations(range(size + 1), 2):
        panel = grid[row - 1, column]
        for marker, part in (("s", slice(None, initial)), ("o", slice(initial, None))):
            u, v = inputs[part, column], inputs[part, row]
            panel.scatter(u, v, s=22, c=shades[part], marker=marker, edgecolors=style.BLACK, linewidths=0.7, zorder=3)
        panel.set(xlim=_around(bounds[column]), ylim=_around(bounds[row]))
        panel.set(xlabel=axes[column] if row == size else "", ylabel=axes[row] if column == 0 else "")
    for row, column in zip(*np.triu_indices(size, 1), strict=True):
        grid[row, column].remove()
    _order_legend(figure, grid[0, 0], colours)
    figure.align_labels()
    return figure


def _order_legend(figure: Figure, panel: Axes, mappable: ScalarMappable | None) -> None:
    """The meaning of squares, circles and colours."""
    for marker, text in (("s", "initial design"), ("o", "chosen one after another")):
        panel.plot([], [], marker, ms=6, mfc="white", mec=style.BLACK, mew=0.7, label=text)
    if mappable is not None:
        figure.colorbar(mappable, ax=figure.axes, label="Order (0 first, 1 last)", ticks=np.linspace(0, 1, 6))
    style.legend(figure, panel)


def _smooth_order(inputs: np.ndarray, bounds: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Mean order of the experiments, each weighted by a Gaussian of its distance; stays within 0 and 1 everywhere."""
    order = _order(len(inputs))
    span = bounds[:, 1] - bounds[:, 0]
    width = 0.5 / np.sqrt(len(inputs))  # half the distance of neighbours in the unit square
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    distance = (((grid[..., None, :] - inputs) / span / width) ** 2).sum(-1)
    # Relative to the nearest experiment: otherwise every weight would be zero far from all experiments.
    weights = np.exp(-0.5 * (distance - distance.min(-1, keepdims=True)))
    return (weights * order).sum(-1) / weights.sum(-1)


def _order(count: int) -> np.ndarray:
    return np.arange(count) / max(count - 1, 1)


def _around(bounds: np.ndarray) -> tuple[float, float]:
    """Limits that leave room for a marker on each side."""
    low, high = float(bounds[0]), float(bounds[1])
    room = 0.03 * (high - low) or 0.5
    return low - room, high + room
