"""The style of every figure: size, fonts, colours, the words and units on its axes, and its files.

Colour-blind readers can distinguish the colours. Compared series also differ in line style or width, for black-and-white
prints.
"""

import io
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from hsed_jax.criticism.prediction import Prediction
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.laws import LAWS
from hsed_jax.physics.names import OWNER, own_name, owner_of
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE, Pair
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.structures import parameter_of
from hsed_jax.reporting.saving import in_house_style, write

WIDTH = 7.0
"""Width of every figure [inch]: a page of text."""

BLACK, DARK_GREY, GREY, BLUE, RED = "#000000", "#808080", "#a0a0a0", "#0072b2", "#d03a10"
COLOUR_MAP = "viridis"

MEASURED = {"color": BLACK, "linestyle": (0, (4, 1.6)), "linewidth": 1.1, "label": "measured (HS)", "zorder": 3}
PREDICTED = {"color": BLUE, "linestyle": "-", "linewidth": 1.3, "label": "predicted (CS)", "zorder": 2}


@dataclass(frozen=True, repr=False)
class Picture:
    """A figure with its caption and its content as alternative text."""

    figure: Figure
    caption: str
    alt: str

    def __post_init__(self):
        """Find the layout once and keep it: it would move a little each time the figure is drawn."""
        for panel in self.figure.axes:
            _set_powers_of_ten(panel.xaxis)
            _set_powers_of_ten(panel.yaxis)
        engine = self.figure.get_layout_engine()
        assert engine is not None
        engine.execute(self.figure)
        # Not "none": a figure with this engine is drawn once more whenever it is saved.
        self.figure.set_layout_engine(None)

    def __repr__(self) -> str:
        return f"Picture: {self.caption}"

    @in_house_style
    def _repr_png_(self) -> bytes:
        # A figure made without pyplot does not show itself in a notebook.
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="png", dpi=110)
        return buffer.getvalue()


Drawing = tuple[str, Callable[[], Picture | None]]
"""The name of a picture's files, and its drawing function; None without data."""


def _set_powers_of_ten(axis: Axis) -> None:
    """Write a power of ten of an axis as ×10⁴; without one, no number is set as mathematics."""
    formatter = axis.get_major_formatter()
    if isinstance(formatter, ScalarFormatter):
        formatter.set_locs(list(axis.get_majorticklocs()))
        formatter.set_useMathText(bool(formatter.get_offset()))


def save(picture: Picture, folder: str | Path, name: str) -> tuple[Path, Path]:
    """Write `name.png` and `name.svg` into a folder, as `saving.write` does, and return their paths."""
    return write(picture.figure, picture.caption, picture.alt, Path(folder), name)


def new_figure(height: float) -> Figure:
    """An empty figure [inch] that is in no global registry, so that a batch of thousands leaks no memory."""
    return Figure(figsize=(WIDTH, height), layout="constrained")


def panels(count: int, height: float, across: int = 2) -> tuple[Figure, list[Axes]]:
    """A figure of `count` panels, `across` in a row, each `height` inches high."""
    rows = -(-count // across)
    figure = new_figure(height * rows + 0.2)
    grid = list(figure.subplots(rows, min(count, across), squeeze=False).flat)
    for surplus in grid[count:]:
        surplus.remove()
    return figure, grid[:count]


def panel_titles(panels: Iterable[Axes]) -> None:
    """Letter the panels a), b), ... in reading order, unless there is but one."""
    panels = list(panels)
    for index, panel in enumerate(panels if len(panels) > 1 else []):
        panel.set_title(f"{_letter(index)})", loc="left")


def recorded(panel: Axes, prediction: Prediction, row: int, name: str) -> np.ndarray:
    """A channel as measured, also where it is not scored; shades the part that is, where that is not all."""
    record = prediction.experiments[row].record
    assert record is not None
    used = prediction.used[row, prediction.columns(name)][: len(record)]
    if used.any() and not used.all():
        top = panel.get_xaxis_transform()
        panel.fill_between(record.time, 0, 1, where=used, transform=top, color=GREY, alpha=0.18, linewidth=0,
                           label="scored", zorder=0)  # fmt: skip
    return record.channels.get(name, np.where(used, prediction.histories(row, name)[0], np.nan))


def legend(figure: Figure, *panels: Axes) -> None:
    """One legend above the panels, where it covers no data; an entry that several panels share stands once."""
    entries: dict[str, Artist] = {}
    for panel in panels:
        handles, texts = panel.get_legend_handles_labels()
        entries.update(zip(texts, handles, strict=True))
    if entries:
        # A line has some 95 letters; the key of each entry takes eight of them.
        lines = -(-sum(8 + len(text) for text in entries) // 95)
        columns = -(-len(entries) // lines)
        figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=columns)


def whole_numbers(axis: Axis) -> None:
    """Tick whole numbers only."""
    axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def levels(values: np.ma.MaskedArray) -> np.ndarray:
    """Round contour levels that enclose the values, also for equal or missing values."""
    low, high = (float(values.min()), float(values.max())) if values.count() else (0.0, 1.0)
    if high - low <= 1e-9 * abs(high):
        low, high = low - 0.05 * (abs(low) or 1.0), high + 0.05 * (abs(high) or 1.0)
    return np.asarray(MaxNLocator(nbins=10, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))


def channel_title(name: str, pair: Pair = ELONGATION_AND_FORCE) -> str:
    """A channel or quantity with its symbol: ``Force $r$``, or of a specimen that is turned ``Moment $M$``."""
    return f"{pair.called(own_name(name)).capitalize()} ${pair.output(name).symbol}$"


def channel_label(name: str, unit: str, pair: Pair = ELONGATION_AND_FORCE) -> str:
    """Axis label of a channel or quantity in a given unit: ``Force $r$ [kN]``."""
    return f"{channel_title(name, pair)} [{unit_text(unit)}]"


def words(name: str) -> str:
    """The name of an effect or a specimen in running text; an effect after the specimen that it is of."""
    return name.replace("_", " ").replace(".", ": ")


def history_label(name: str, unit: str, pair: Pair = ELONGATION_AND_FORCE) -> str:
    """`channel_label` in several lines where the name is long, for panels that stand low above one another."""
    lines = textwrap.wrap(pair.called(own_name(name)).capitalize(), 14)
    whole = channel_label(name, unit, pair)
    return whole if len(lines[0]) <= 12 and len(lines) == 1 else "\n".join([*lines, whole[whole.index("$") :]])


def label(name: str, unit: str, width: int = 16) -> str:
    """Axis label of an input or a parameter: its name as studies and tables have it, in lines of about `width` letters."""
    lines = [""]
    for part in re.split(r"(?<=[._])", plain(name)):
        lines = [*lines, part] if lines[-1] and len(lines[-1] + part) > width else [*lines[:-1], lines[-1] + part]
    return "\n".join(lines) + f" [{unit_text(unit)}]"


def symbol(name: str) -> str:
    """The symbol that a parameter declares, in dollars; otherwise a short name as a symbol, V_P; otherwise the name as
    words.
    """
    owner, own = owner_of(name), own_name(name)
    if owner == OWNER:
        return f"${parameter_of(own).symbol}$"
    place, effect = (owner_of(owner), own_name(owner)) if own_name(owner) in EFFECTS else (owner, "")
    sources = [EFFECTS[effect]] if effect else [] if "." in place else LAWS.values()
    declared = next((known[own] for source in sources if own in (known := parameters_of(source))), None)
    if declared:
        mark = place.replace("_", r"\_")
        return rf"${declared.symbol}\,\mathrm{{({mark})}}$" if place else f"${declared.symbol}$"
    if match := re.fullmatch(r"([A-Za-z])(?:_([A-Za-z0-9]+))?", name):
        stem, index = match.groups()
        return f"${stem}_{{{index}}}$" if index else f"${stem}$"
    return name.replace("_", " ").replace("$", r"\$")


def plain(name: str, longest: int = 40) -> str:
    """A name that somebody else chose, cut where it is too long, its dollars no mathematics."""
    return (name if len(name) <= longest else name[: longest - 1] + "…").replace("$", r"\$")


def unit_text(unit: str) -> str:
    """A unit in print: ``m/s^2`` → m/s², no unit → –."""
    if unit in ("1", "-", ""):
        return "–"
    raised = re.sub(r"\^\(([^)]*)\)|\^(-?\d+)", lambda m: f"$^{{{m[1] or m[2]}}}$", unit)
    return raised.replace("*", "·")


def lettered(names: Sequence[str]) -> str:
    """The panels named in a caption: ``a) A, b) beta``."""
    return ", ".join(f"{_letter(i)}) {name}" for i, name in enumerate(names)) if len(names) > 1 else "".join(names)


def amount(value: float, unit: str = "1") -> str:
    """A number with its unit in running text, where symbols cannot be set."""
    if not np.isfinite(value):
        return "no value"
    return f"{value:.3g}" if unit in ("1", "-", "") else f"{value:.3g} {unit}"


def peak(values: npt.ArrayLike, unit: str = "1") -> str:
    """The largest absolute value in running text."""
    return amount(max(np.abs(np.asarray(values, dtype=float))[np.isfinite(values)].flat, default=np.nan), unit)


def _letter(index: int) -> str:
    """a … z, then aa, ab, ..."""
    return (_letter(index // 26 - 1) if index >= 26 else "") + "abcdefghijklmnopqrstuvwxyz"[index % 26]
