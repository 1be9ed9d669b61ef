"""The figure of a posterior: the draws of every parameter and of every pair of parameters."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from hsed_jax.inference.fit import Fit
from hsed_jax.physics import display
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture

_MOST = 6
_BINS = 30
# Of more parameters than this, panels are so narrow that they have short lines of words and few numbers.
_WIDE = 4
_DASHES = (0, (4, 1.6))
_LOOKS = {"as it was": (style.RED, "v"), "improved": (style.BLUE, "o")}


@style.in_house_style
def posterior(fit: Fit, before: Fit | None, truth: Mapping[str, float]) -> Picture:
    """The draws of every parameter as histograms, of every pair as points below them, the MAP on both.

    Arguments:
        fit: the calibrated model; of more than six parameters the first six are shown.
        before: the first model, drawn beneath; None for none.  It may lack some of the parameters.
        truth: values to be drawn as lines, SI, by name.
    """
    names = fit.names[:_MOST]
    fits = {"improved": fit} if before is None else {"as it was": before, "improved": fit}
    draws = {look: _draws(one) for look, one in fits.items()}
    scales = {
        name: display.readable(fit.units.get(name, "1"), *(d[name] for d in draws.values() if name in d))
        for name in names
    }
    count = len(names)
    width, numbers = (16, 4) if count <= _WIDE else (10, 2)
    figure = style.new_figure(min(1.4 + 1.6 * count, 8.0))
    grid, above = figure.add_gridspec(count, count), {}
    for row, y in enumerate(names):
        for column, x in enumerate(names[: row + 1]):
            panel = above[column] = figure.add_subplot(grid[row, column], sharex=above.get(column))
            for look, one in fits.items():
                if {x, y} <= set(one.names):
                    values = [draws[look][name] / scales[name][0] for name in (x, y)]
                    at = [one.map[name] / scales[name][0] for name in (x, y)]
                    _pair(panel, values, at, look) if x != y else _marginal(panel, values[0], at[0], look)
            _lines(panel, *(truth[n] / scales[n][0] if n in truth else None for n in (x, y)), alone=x == y)
            panel.set_xlabel(style.label(x, scales[x][1], width) if row == count - 1 else "")
            panel.set_ylabel(style.label(y, scales[y][1], width) if column == 0 and row > 0 else "")
            panel.tick_params(labelbottom=row == count - 1, labelleft=column == 0 and row > 0)
            panel.locator_params("x", nbins=numbers)
            panel.locator_params("y", nbins=4)
    figure.align_labels()
    _entries(figure.axes[0], list(fits), any(name in truth for name in names))
    style.legend(figure, figure.axes[0])
    rest = len(fit.names) - count
    said = "; ".join(
        f"{name} {style.amount(fit.map[name] / scales[name][0], scales[name][1])}" for name in names if name in fit.map
    )
    return Picture(
        figure,
        "Posterior of the parameters: histograms of the draws, each with its own scale, and the draws of every pair; marked is "
        "the MAP."
        + ("  Red: the model as it was." if before is not None else "")
        + ("  Dashed: true values." if truth else "")
        + (f"  {rest} more parameters are not shown." if rest else ""),
        f"{count} histograms and {count * (count - 1) // 2} scatter plots. MAP: {said}.",
    )


def _draws(fit: Fit) -> dict[str, np.ndarray]:
    draws = np.asarray(fit.chains.theta)
    return {name: draws[..., i].ravel() for i, name in enumerate(fit.names)}


def _marginal(panel: Axes, values: np.ndarray, at: float, look: str) -> None:
    colour, marker = _LOOKS[look]
    counts, edges = np.histogram(values, _BINS)
    # Each is scaled to its own height: as densities, a sharp posterior would flatten a broad one beside it.
    panel.stairs(counts / max(counts.max(), 1), edges, fill=True, facecolor=colour, alpha=0.45, edgecolor=colour)
    panel.plot([at], [0.0], marker, color=colour, ms=5, mec="white", mew=0.6, zorder=4, clip_on=False)
    panel.set_yticks([])
    panel.grid(False, axis="y")
    panel.spines["left"].set_visible(False)


def _pair(panel: Axes, values: list[np.ndarray], at: list[float], look: str) -> None:
    colour, marker = _LOOKS[look]
    panel.plot(*values, ".", color=colour, ms=1.6, alpha=0.25, mew=0, rasterized=True)
    panel.plot(*([x] for x in at), marker, color=colour, ms=5, mec="white", mew=0.6, zorder=4)


def _lines(panel: Axes, x: float | None, y: float | None, alone: bool) -> None:
    look = {"color": style.BLACK, "linestyle": _DASHES, "linewidth": 1.0, "zorder": 3}
    if x is not None:
        panel.axvline(x, **look)
    if y is not None and not alone:
        panel.axhline(y, **look)


def _entries(panel: Axes, looks: list[str], has_truth: bool) -> None:
    """The meaning of colours and marks."""
    for look in looks:
        colour, marker = _LOOKS[look]
        both = len(looks) == 2
        panel.plot([], [], "s", color=colour, alpha=0.45, ms=8, mew=0, label=f"{look}: draws" if both else "draws")
        panel.plot([], [], marker, color=colour, ms=5, label=f"{look}: MAP" if both else "MAP")
    if has_truth:
        panel.plot([], [], color=style.BLACK, linestyle=_DASHES, linewidth=1.0, label="true value")
