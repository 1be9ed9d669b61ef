"""The place of the misfit: over the coordinates of the samples, and over the inputs of the experiments."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hsed_jax.criticism.coordinates import UNITS, Samples
from hsed_jax.criticism.locate import Location, Place
from hsed_jax.measurements import Campaign
from hsed_jax.physics import display
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture

_BINS = 10
_WORDS = 8
_NAMED = 3
_ALPHA = 0.6
_LABEL = {"facecolor": "white", "alpha": 0.6, "linewidth": 0, "pad": 0.6}
_AXES = {
    "time": "Time",
    "cycle": "Cycle",
    "amplitude": "Elongation",
    "energy": "Absorbed energy",
    "speed": "Elongation rate",
}
_MARKERS = {"train": "o", "test": "s"}


@style.in_house_style
def residual_coordinates(location: Location, campaign: Campaign) -> Picture | None:
    """Share of the squared error over each coordinate of the samples, beside the share of the samples.

    A panel per coordinate that varies: time, cycle, amplitude, absorbed energy, speed and the inputs in tenths of the
    samples; branch, sign of the force, output and experiment by word.

    Arguments:
        location: of histories; `places` are highlighted.
        campaign: where the samples come from: whether it has a time, and the units of its inputs.

    Returns:
        The picture; None where no coordinate varies or only quantities were compared.
    """
    samples = location.samples
    if samples is None:
        return None
    places = {_coordinate(place): (rank, place) for rank, place in enumerate(location.places, start=1)}
    numbers = {name: found for name, found in _numbers(samples, campaign).items() if np.ptp(found[0][found[1]]) > 0}
    words = {name: values for name, values in samples.words.items() if np.unique(values).size > 1}
    if not numbers and not words:
        return None
    figure, panels = style.panels(len(numbers) + len(words), 1.9, across=3)
    for panel, (name, (values, known, label)) in zip(panels, numbers.items(), strict=False):
        _tenths(panel, values[known], samples.share[known], places.get(name, (0, None))[1])
        panel.set_xlabel(label)
    for panel, (name, values) in zip(panels[len(numbers) :], words.items(), strict=True):
        _bars_by_word(panel, values, samples.share, places.get(name, (0, None))[1])
        panel.set_xlabel(f"{campaign.pair.words(name).capitalize()}: share [%]")
    for index, (panel, name) in enumerate(zip(panels, [*numbers, *words], strict=True)):
        if index % 3 == 0 and name in numbers:
            panel.set_ylabel("Share [%]")
        if name in places:
            rank, place = places[name]
            panel.set_title(f"no. {rank}: {100 * place.error_share:.0f} %", loc="right", color=style.RED)
    panels[0].plot([], [], color=style.BLACK, linewidth=1.2, label="share of the samples")
    marks = [(style.BLUE, "share of the squared error"), (style.RED, "of that, the ranked part")]
    for colour, text in marks if places else marks[:1]:
        panels[0].plot([], [], "s", color=colour, alpha=_ALPHA, ms=8, label=text)
    style.panel_titles(panels)
    style.legend(figure, panels[0])
    said = "; ".join(location.sentences) or "the misfit is not concentrated in any part of the data"
    return Picture(
        figure,
        "Where the squared error of the training experiments lies: bars, by the coordinates of the samples, ordered "
        "coordinates in tenths of the samples; black, the share of the samples.  Red: the part "
        "where the residual differs most, by rank, with its share of the error.",
        f"Bar charts over {', '.join([*numbers, *words])}. Ranked: {said}.",
    )


def _coordinate(place: Place) -> str:
    """The name of a coordinate in its samples."""
    return "time" if place.coordinate == "row" else place.coordinate


def _numbers(samples: Samples, campaign: Campaign) -> dict[str, tuple[np.ndarray, np.ndarray, str]]:
    """Values, their known ones, and axis label of every ordered coordinate, including the inputs."""
    found, pair = {}, campaign.pair
    for name, values in samples.numbers.items():
        values = np.asarray(values, dtype=float)
        divisor, unit = display.shown_in(pair, UNITS[name], values)
        symbol = f" $|{pair.elongation_symbol}|$" if name == "amplitude" else ""
        label = f"{pair.words(_AXES[name])}{symbol} [{style.unit_text(unit)}]"
        if name == "time" and not campaign.has_time:
            label = "Row"
        found[name] = (values / divisor, label if name != "cycle" else "Cycle")
    ids, row = np.unique(samples.words["experiment"], return_inverse=True)
    for name in campaign.inputs:
        unit = campaign.unit(name)
        values = np.asarray([unit.from_si(campaign[str(id)].inputs[name]) for id in ids])[row]
        found[name] = (values, style.label(name, unit.text))
    return {
        name: (values, np.isfinite(values), label)
        for name, (values, label) in found.items()
        if np.isfinite(values).any()
    }


def _tenths(panel: Axes, values: np.ndarray, share: np.ndarray, place: Place | None) -> None:
    """Share of the error in every tenth of the samples; where values repeat, a bin holds more than a tenth."""
    edges = np.unique(values)
    few = edges.size <= _BINS  # a bin per value
    if not few:
        edges = np.unique(np.quantile(values, np.linspace(0, 1, _BINS + 1), method="inverted_cdf"))
    count = edges.size if few else edges.size - 1
    which = np.minimum(np.searchsorted(edges, values, side="right") - 1, count - 1)
    error = 100 * np.bincount(which, share, count) / max(float(share.sum()), 1e-300)
    size = 100 * np.bincount(which, minlength=count) / values.size
    bins = np.arange(error.size)
    inside = np.zeros(bins.size, dtype=bool)
    if place is not None and place.limit is not None:
        # The axis counts samples, so the limit stands at the number of samples below it.
        before = 100 * (1 - place.sample_share if place.part == "above" else place.sample_share)
        at = float(np.interp(before, np.append(0.0, np.cumsum(size)), np.arange(bins.size + 1)))
        inside = (bins + 0.5 > at) if place.part == "above" else (bins + 0.5 < at)
        panel.axvspan(*((at, bins.size) if place.part == "above" else (0, at)), color=style.RED, alpha=0.1, linewidth=0)
    panel.bar(bins + 0.5, error, 0.85, color=np.where(inside, style.RED, style.BLUE), alpha=_ALPHA)
    panel.stairs(size, np.arange(bins.size + 1), color=style.BLACK, linewidth=1.2, baseline=None, zorder=3)
    labelled = min(5, (edges.size + 1) // 2) if edges.size > 4 else edges.size
    ticks = np.round(np.linspace(0, edges.size - 1, labelled)).astype(int)
    # A value far below the largest reads as zero.
    decimals = 3 - int(np.floor(np.log10(np.abs(edges).max())))
    shown = np.round(edges[ticks], decimals) + 0.0
    panel.set_xticks(ticks + 0.5 * few, [f"{x:.3g}" if abs(x) < 1000 else f"{x:.0f}" for x in shown])
    panel.set_xlim(0, bins.size)
    panel.grid(False, axis="x")


def _bars_by_word(panel: Axes, words: np.ndarray, share: np.ndarray, place: Place | None) -> None:
    """Share of the error of every word, the largest on top; more words than fit are one bar."""
    names, which = np.unique(words, return_inverse=True)
    error = 100 * np.bincount(which, weights=share, minlength=names.size)
    size = 100 * np.bincount(which, minlength=names.size) / words.size
    part = "" if place is None else place.part
    order = sorted(range(names.size), key=lambda i: (names[i] != part, -error[i]))
    order, rest = (order[: _WORDS - 1], order[_WORDS - 1 :]) if names.size > _WORDS else (order, [])
    order.sort(key=lambda i: -error[i])
    labels = [style.plain(str(names[i]), 24) for i in order] + ([f"{len(rest)} others"] if rest else [])
    error, size = (np.append(x[order], [x[rest].sum()] if rest else []) for x in (error, size))
    colours = [style.RED if names[i] == part else style.BLUE for i in order] + ([style.BLUE] if rest else [])
    at = np.arange(len(labels))
    panel.barh(at, error, 0.75, color=colours, alpha=_ALPHA)
    panel.vlines(size, at - 0.45, at + 0.45, color=style.BLACK, linewidth=1.2, zorder=3)
    for height, text in enumerate(labels):  # inside: beside the panel, long words would squeeze its column
        panel.text(0.025, height, text, transform=panel.get_yaxis_transform(), va="center_baseline", fontsize=8,
                   bbox=_LABEL, zorder=4)  # fmt: skip
    panel.set_yticks([])
    panel.invert_yaxis()
    panel.grid(False, axis="y")


@style.in_house_style
def error_map(found: xr.Dataset) -> Picture:
    """Squared error of each experiment over the inputs, and its Kriging in between.

    Arguments:
        found: as `hsed_jax.criticism.error_map` gives it, of one or two inputs.
    """
    names = found["input"].values.tolist()
    points, errors = found["at"].values, found["squared_error"].values
    ids = found["experiment"].values.tolist()
    labels = [style.label(name, found[name].attrs["units"]) for name in names]
    figure = style.new_figure(4.2 if len(names) == 2 else 3.0)
    panel = figure.subplots()
    (_errors_over_a_plane if len(names) == 2 else _errors_along_a_line)(figure, panel, found)
    panel.set_xlabel(labels[0])
    panel.set_ylabel(labels[1] if len(names) == 2 else "Squared error [–]")
    _name_largest(panel, np.stack([points[:, 0], points[:, 1] if len(names) == 2 else errors], axis=1), errors, ids)
    style.legend(figure, panel)
    told = "squared_error_mean" in found
    return Picture(
        figure,
        "Squared error of each experiment, relative to the variance of the measurement, over the inputs; the largest "
        "are named."
        + ("  Between the experiments, the mean and the standard deviation of a Kriging model." if told else ""),
        f"{len(ids)} experiments over {', '.join(names)}; squared error between {style.amount(float(errors.min()))} "
        f"and {style.amount(float(errors.max()))}, the largest in {ids[int(np.argmax(errors))].replace('$', '')}.",
    )


def _name_largest(panel: Axes, places: np.ndarray, errors: np.ndarray, ids: list[str]) -> None:
    """Write the names of the experiments with the largest errors beside them, but no name over another."""
    near = 0.07 * np.maximum(np.ptp(places, axis=0), 1e-300)
    named: list[int] = []
    for i in np.argsort(-errors)[:_NAMED]:
        if any((np.abs(places[i] - places[other]) < near).all() for other in named):
            continue
        named.append(i)
        left = places[i, 0] > places[:, 0].mean()  # the name is placed inwards, because there is room
        panel.annotate(
            style.plain(ids[i], 24), (places[i, 0], places[i, 1]), (-9 if left else 9, 0), fontsize=7, zorder=5,
            textcoords="offset points", ha="right" if left else "left", va="center_baseline", bbox=_LABEL,
        )  # fmt: skip


def _errors_over_a_plane(figure: Figure, panel: Axes, found: xr.Dataset) -> None:
    points, errors, sets = (found[name].values for name in ("at", "squared_error", "split"))
    x, y = (found[name].values for name in found["input"].values.tolist())
    is_known = "squared_error_mean" in found
    levels = style.levels(np.ma.asarray(np.append(errors, found["squared_error_mean"]) if is_known else errors))
    shades = {"vmin": levels[0], "vmax": levels[-1], "cmap": style.COLOUR_MAP}
    if is_known:
        sd = found["squared_error_sd"].values
        panel.contourf(x, y, found["squared_error_mean"].values.T, levels, alpha=0.75, **shades)
        if np.ptp(sd) > 1e-6 * float(errors.max(initial=0.0)):
            lines = panel.contour(x, y, sd.T, 4, colors="white", linewidths=0.6, linestyles="-")
            panel.clabel(lines, fontsize=6, fmt="%.2g")
            panel.plot([], [], color=style.GREY, linewidth=0.6, label="standard deviation of the map")
    sizes = 20 + 130 * np.sqrt(errors / max(float(errors.max()), 1e-300))
    for split, marker in _MARKERS.items():
        one = sets == split
        if one.any():
            drawn = panel.scatter(
                *points[one].T, s=sizes[one], c=errors[one], marker=marker, edgecolors=style.BLACK, linewidths=0.9,
                zorder=3, **shades,
            )  # fmt: skip
            panel.plot([], [], marker, ms=6, mfc="white", mec=style.BLACK, mew=0.9, label=split)
            mappable = drawn
    panel.set(xlim=x[[0, -1]], ylim=y[[0, -1]])
    panel.grid(False)
    figure.colorbar(mappable, ax=panel, label="Squared error [–]")


def _errors_along_a_line(figure: Figure, panel: Axes, found: xr.Dataset) -> None:
    points, errors, sets = (found[name].values for name in ("at", "squared_error", "split"))
    x = found[found["input"].values.item()].values
    if "squared_error_mean" in found:
        mean, sd = found["squared_error_mean"].values, found["squared_error_sd"].values
        band = np.maximum(mean - 1.645 * sd, 0.0), mean + 1.645 * sd
        panel.fill_between(x, *band, color=style.BLUE, alpha=0.2, linewidth=0, label="90 % band")
        panel.plot(x, mean, color=style.BLUE, linewidth=1.3, label="Kriging mean")
    for split, marker in _MARKERS.items():
        one = sets == split
        if one.any():
            fill = style.BLACK if split == "train" else "white"
            panel.plot(points[one, 0], errors[one], marker, ms=5, mfc=fill, mec=style.BLACK, zorder=3, label=split)
    panel.set_xlim(*x[[0, -1]])
    panel.set_ylim(bottom=0.0)
