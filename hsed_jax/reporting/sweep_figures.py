"""Figures of many studies: the results over the swept keys, and Sobol' indices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import cast

import matplotlib
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hsed_jax.physics import display
from hsed_jax.reporting.style import (
    BLACK,
    BLUE,
    COLOUR_MAP,
    DARK_GREY,
    GREY,
    Picture,
    in_house_style,
    label,
    legend,
    new_figure,
    panel_titles,
    panels,
    plain,
    symbol,
    whole_numbers,
)

_MOST_ESTIMATES, _MOST_KEYS, _MOST_LABELLED = 4, 4, 6
_ERRORS = {
    "error_test_improved": "Test error, improved [–]",
    "error_test": "Test error [–]",
    "error_train": "Training error [–]",
}
_LETTERS_ACROSS = 100
_DASHES = ("-", "--", ":", "-.")
# Values over more than this ratio are spread evenly by their logarithms.
_WIDE = 30.0


@dataclass(frozen=True)
class _Outcome:
    """A column of the table with the interval around it, if any, and how its axis is labelled."""

    column: str
    text: str
    divisor: float = 1.0
    interval: tuple[str, str] | None = None
    is_logarithmic: bool = False

    def of(self, rows: pd.DataFrame) -> tuple[np.ndarray, np.ndarray | None]:
        """Values (n,) and lengths of the interval below and above them (2, n), as drawn."""
        middle = rows[self.column].to_numpy(float) / self.divisor
        if self.interval is None or not set(self.interval) <= set(rows):
            return middle, None
        low, high = (rows[name].to_numpy(float) / self.divisor for name in self.interval)
        # A MAP may lie outside its interval.
        return middle, np.maximum(0.0, np.nan_to_num(np.stack([middle - low, high - middle])))


@in_house_style
def comparison(table: pd.DataFrame, keys: Sequence[str], is_grid: bool, units: Mapping[str, str]) -> Picture:
    """Estimates with their 90 % intervals and errors over the swept keys.

    For a grid, the key with most values is the horizontal axis, with a line for each combination of the others. For other
    points, each key has a column of panels.

    Arguments:
        table: a row per study; those that did not complete are left out.
        keys: columns of it that were swept.
        is_grid: whether the points are all combinations of their values.
        units: SI unit by parameter.
    """
    done = table.query("status == 'complete'")
    outcomes = _outcomes(done, units)
    shown = ", ".join(outcome.column for outcome in outcomes)
    if is_grid:
        figure, axes = panels(len(outcomes), 2.3)
        across = max(keys, key=lambda key: (_is_numeric(done.loc[:, key]), done.loc[:, key].nunique()))
        others = [key for key in keys if key != across]
        for ax, outcome in zip(axes, outcomes, strict=True):
            _lines(ax, done, across, others, outcome)
        _legend(figure, axes)
        over = f"{across}, a line for each {' and '.join(others)}" if others else across
    else:
        columns = list(keys)[:_MOST_KEYS]
        figure, axes = panels(len(outcomes) * len(columns), 2.0, across=len(columns))
        for index, ax in enumerate(axes):
            row, column = divmod(index, len(columns))
            _points(ax, done, columns[column], columns, outcomes[row])
            if column:
                ax.set_ylabel("")
        over = " and ".join(columns)
    panel_titles(axes)
    caption = f"{len(done)} studies of a sweep: {shown} over {over}. Bars are 90 % intervals of the posterior."
    ranges = "; ".join(f"{o.column} from {done[o.column].min():.3g} to {done[o.column].max():.3g}" for o in outcomes)
    return Picture(figure, caption, f"Results of a sweep over {over}: {ranges}")


def _outcomes(done: pd.DataFrame, units: Mapping[str, str]) -> list[_Outcome]:
    found = []
    for column in [name for name in done if name.startswith("map.")][:_MOST_ESTIMATES]:
        name = column.removeprefix("map.")
        divisor, unit = display.readable(units.get(name, "1"), done[column].to_numpy(float))
        found.append(_Outcome(column, label(name, unit), divisor, (f"q05.{name}", f"q95.{name}")))
    if errors := [name for name in _ERRORS if name in done]:
        found.append(_Outcome(errors[0], _ERRORS[errors[0]]))
    if "max_expected_improvement" in done:
        found.append(_Outcome("max_expected_improvement", "Max EI at the end", is_logarithmic=True))
    return found or [_Outcome("seconds", "Time [s]")]


def _lines(ax: Axes, done: pd.DataFrame, across: str, others: list[str], outcome: _Outcome) -> None:
    groups = list(done.groupby(others, sort=True, dropna=False)) if others else [((), done)]
    colours = matplotlib.colormaps[COLOUR_MAP](np.linspace(0.0, 0.85, len(groups)))
    shift = np.linspace(-0.5, 0.5, len(groups)) if len(groups) > 1 else [0.0]
    place = _axis(ax, done.loc[:, across], _short(across, [across, *others]))
    for (values, rows), colour, dash, offset in zip(groups, colours, cycle(_DASHES), shift, strict=False):
        rows = rows.sort_values(across)
        text = ", ".join(
            f"{_short(key, others)} = {value}"
            for key, value in zip(others, cast("tuple[object, ...]", values), strict=True)
        )
        middle, around = outcome.of(rows)
        ax.errorbar(
            place(rows[across], float(offset)),
            middle,
            around,
            color=colour,
            linestyle=dash,
            marker="o",
            linewidth=1.2,
            elinewidth=0.8,
            label=plain(text, 80) if 1 < len(groups) <= _MOST_LABELLED else None,
        )
    ax.set_ylabel(outcome.text)
    if outcome.is_logarithmic:
        ax.set_yscale("log")


def _short(key: str, keys: Sequence[str]) -> str:
    """The last two parts of a dotted path, where they are those of no other key."""
    ends = [".".join(other.split(".")[-2:]) for other in keys]
    end = ".".join(key.split(".")[-2:])
    return end if ends.count(end) == 1 else key


def _legend(figure: Figure, axes: Sequence[Axes]) -> None:
    """One legend above the panels, in as many columns as there is room for."""
    handles, texts = axes[0].get_legend_handles_labels()
    if texts:
        columns = max(1, min(int(_LETTERS_ACROSS / (max(map(len, texts)) + 8)), len(texts)))
        figure.set_figheight(figure.get_figheight() + 0.2 * (len(texts) // columns))
        figure.legend(handles, texts, loc="outside upper center", ncols=columns)


def _points(ax: Axes, done: pd.DataFrame, key: str, keys: Sequence[str], outcome: _Outcome) -> None:
    place = _axis(ax, done.loc[:, key], _short(key, keys))
    middle, around = outcome.of(done)
    ax.errorbar(place(done[key], 0.0), middle, around, color=BLUE, ecolor=GREY, fmt="o", elinewidth=0.8)
    ax.set_ylabel(outcome.text)
    if outcome.is_logarithmic:
        ax.set_yscale("log")


def _axis(ax: Axes, values: pd.Series, words: str):
    """Set up the horizontal axis for a key; returns a function for the positions of its values, with a small offset."""
    ax.set_xlabel(plain(words))
    if not _is_numeric(values):
        known = sorted(values.astype(str).unique())
        ax.set_xticks(range(len(known)), [plain(word, 16) for word in known])
        return lambda chosen, offset: np.asarray([known.index(word) for word in chosen.astype(str)]) + 0.2 * offset
    if pd.api.types.is_integer_dtype(values):
        whole_numbers(ax.xaxis)
    low, high = float(values.min()), float(values.max())
    if low > 0 and high / low >= _WIDE:
        ax.set_xscale("log")
        return lambda chosen, offset: chosen.to_numpy(float) * (high / low) ** (0.03 * offset)
    return lambda chosen, offset: chosen.to_numpy(float) + 0.03 * (high - low) * offset


def _is_numeric(values: pd.Series) -> bool:
    return pd.api.types.is_numeric_dtype(values) and not pd.api.types.is_bool_dtype(values)


def _symbol(name: str) -> str:
    """The symbol of an input or a parameter; the pulse's own letters are Greek, too."""
    return {"nu": r"$\nu$"}.get(name, symbol(name))


@in_house_style
def sensitivity_bars(indices: xr.Dataset) -> Picture:
    """Sobol' indices with their 90 % intervals, a panel per quantity.

    Arguments:
        indices: `first_order` and `total_order` with `_low` and `_high`, each (quantity, variable).
    """
    quantities = [str(name) for name in indices["quantity"].values]
    variables = [str(name) for name in indices["variable"].values]
    figure = new_figure(1.3 + 0.32 * len(variables))
    axes = list(figure.subplots(1, len(quantities), squeeze=False, sharey=True).flat)
    places = np.arange(len(variables))
    for ax, quantity in zip(axes, quantities, strict=True):
        one = indices.sel(quantity=quantity)
        for kind, words, colour, offset in (
            ("first_order", "first-order (by itself)", GREY, -0.2),
            ("total_order", "total-order (with interactions)", BLUE, 0.2),
        ):
            middle = one[kind].values
            around = np.maximum(
                0.0, np.stack([middle - one[f"{kind}_low"].values, one[f"{kind}_high"].values - middle])
            )
            bars = {"elinewidth": 0.8, "ecolor": BLACK}
            ax.barh(places + offset, middle, 0.38, xerr=around, color=colour, label=words, error_kw=bars)
        ax.axvline(0.0, color=DARK_GREY, linewidth=0.8)
        ax.set_xlabel(f"Index of {quantity.replace('_', ' ')} [–]")
        ax.grid(False, axis="y")
    axes[0].set_yticks(places, [_symbol(name) for name in variables])
    axes[0].invert_yaxis()
    legend(figure, *axes)
    panel_titles(axes)
    told = "; ".join(
        f"{quantity}: "
        + ", ".join(
            f"{name} {float(indices['total_order'].sel(quantity=quantity, variable=name)):.2f}" for name in variables
        )
        for quantity in quantities
    )
    return Picture(
        figure,
        "First-order and total-order Sobol' indices with the 90 % intervals of the bootstrap.",
        f"Bars of Sobol' indices. Total-order: {told}",
    )
