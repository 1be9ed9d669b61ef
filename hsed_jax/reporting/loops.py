"""The measured loops alone, before any fit: a small picture, and a sketch for a terminal.

The house style imports all effects, which loads JAX. This takes longer than all other work on a file before the fit.
"""

import io
from typing import NamedTuple

import numpy as np

from hsed_jax.measurements import Campaign

_MOST = 4000
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))  # of a braille character, by column and row
_FINE = 4  # points of a line per dot of a sketch


class _Loop(NamedTuple):
    """Elongation and force in their declared units, and whether it is never fitted."""

    elongation: np.ndarray
    force: np.ndarray
    is_test: bool


def loops_picture(campaign: Campaign) -> bytes | None:
    """A PNG of all measured loops in one panel, held-out parts in another colour; None without forces or elongations."""
    loops = _loops(campaign)
    if not loops:
        return None
    import matplotlib.style
    from matplotlib.figure import Figure

    with matplotlib.style.context([{"font.size": 8, "axes.grid": True, "grid.color": "#e4e4e4"}], after_reset=True):
        figure = Figure(figsize=(4.2, 3.2), layout="constrained")
        axes = figure.add_subplot()
        for is_test, colour, line in ((False, "#000000", "-"), (True, "#d03a10", "--")):
            shown = [loop for loop in loops if loop.is_test == is_test]
            for k, loop in enumerate(shown):
                label = ("held out" if is_test else "to be fitted") if not k else None
                axes.plot(loop.elongation, loop.force, linewidth=0.8, label=label, color=colour, linestyle=line)
        pair = campaign.pair
        axes.set_xlabel(f"{pair.elongation} [{campaign.unit('elongation').text}]")
        axes.set_ylabel(f"{pair.force} [{campaign.unit('force').text}]")
        if len({loop.is_test for loop in loops}) > 1:
            axes.legend(frameon=False)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=130, metadata={"Title": f"{campaign.name}, as measured"})
    return buffer.getvalue()


def sketch(campaign: Campaign, width: int = 44, height: int = 12) -> str:
    """The measured loops drawn with braille characters; empty where elongation or force was not measured.

    Arguments:
        campaign: the measurements.
        width, height: in characters.
    """
    loops = _loops(campaign)
    if not loops:
        return ""
    across, down = 2 * width - 1, 4 * height - 1
    x, y = (np.concatenate([getattr(loop, name) for loop in loops]) for name in ("elongation", "force"))
    if not (np.ptp(x) > 0 and np.ptp(y) > 0):
        return ""
    cells = np.zeros((height, width), dtype=int)
    for loop in loops:
        column = (loop.elongation - x.min()) / np.ptp(x) * across
        row = (y.max() - loop.force) / np.ptp(y) * down
        steps = np.maximum(np.abs(np.diff(column)), np.abs(np.diff(row)))
        # Lines between samples, as a plot has them.
        at = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-9))])
        fine = np.linspace(0, at[-1], min(int(_FINE * at[-1]) + 2, 200_000))
        columns, rows = np.rint(np.interp(fine, at, column)), np.rint(np.interp(fine, at, row))
        for c, r in {*zip(columns.astype(int).tolist(), rows.astype(int).tolist(), strict=True)}:
            cells[r // 4, c // 2] |= _DOTS[c % 2][r % 4]
    lines = ["".join(chr(0x2800 + dots) for dots in row) for row in cells.tolist()]
    unit, force = campaign.unit("elongation").text, campaign.unit("force").text
    said = f"{x.min():.4g} to {x.max():.4g} {unit} across, {y.min():.4g} to {y.max():.4g} {force} up"
    return "\n".join([*lines, said])


def _loops(campaign: Campaign) -> list[_Loop]:
    loops = []
    for experiment in campaign.completed:
        record = experiment.scored
        if record is None or not {"elongation", "force"} <= record.channels.keys():
            continue
        every = slice(None, None, max(1, len(record) // _MOST))
        elongation, force = (campaign.unit(c).from_si(record[c][every]) for c in ("elongation", "force"))
        whole = np.isfinite(elongation) & np.isfinite(force)
        loops.append(_Loop(elongation[whole], force[whole], experiment.split == "test"))
    return loops
