"""Pictures of the doubts of a check: the loop and the history of a record, with the doubted samples marked.

As in `hsed_jax.reporting.loops`, nothing here needs the house style, which loads JAX.
"""

import io
import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Experiment, Finding
from hsed_jax.physics.names import named, own_name, owner_of

_RC = {"font.size": 8, "axes.grid": True, "grid.color": "#e4e4e4", "axes.spines.top": False, "axes.spines.right": False}
_LINE = {"color": "#808080", "linewidth": 0.7, "zorder": 1}
# Marks differ in form, size and colour, for a print in black and white and for marks that overlap.
_Look = tuple[str, str, float]  # colour, form, size
_MARKS: tuple[_Look, ...] = (
    ("#d03a10", "o", 3.0),
    ("#0072b2", "s", 4.5),
    ("#009e73", "^", 6.0),
    ("#cc79a7", "D", 7.0),
    ("#e69f00", "v", 8.0),
)
_MOST = 20_000  # samples of a line
_SHOWN = 400  # marks of a doubt
_HISTORIES = 3
_WIDEST = 125  # letters of a line


def write_pictures(campaign: Campaign, findings: Sequence[Finding], folder: Path) -> Iterator[tuple[str, Path]]:
    """Draw every doubted record, and write it into a folder as `doubts_<experiment>.png`.

    Arguments:
        campaign: the measurements.
        findings: of its check; errors are not drawn.
        folder: of the pictures; created if it is missing.

    Yields:
        The experiment and its file.

    Raises:
        UserError: the folder cannot be written.
    """
    for experiment in campaign:
        doubts = [f for f in findings if f.level == "doubt" and f.experiment == experiment.id]
        content = doubts_picture(campaign, experiment, doubts)
        if content is None:
            continue
        path = folder / f"doubts_{re.sub(r'[^\w.+-]', '_', experiment.id)}.png"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_whole(path, content)
        except OSError as error:
            raise UserError(f"{path}: cannot be written ({error.strerror})") from None
        yield experiment.id, path


def doubts_picture(campaign: Campaign, experiment: Experiment, doubts: Sequence[Finding]) -> bytes | None:
    """A PNG of a record and its doubts: the loop at the left, the histories of the doubted channels at the right.

    Arguments:
        campaign: the measurements.
        experiment: of which the record is drawn.
        doubts: of this record.

    Returns:
        The picture; None without a doubt of a channel of the record, or if the record has missing numbers.
    """
    record = experiment.record
    if record is None or not all(np.isfinite(v).all() for v in (record.time, *record.channels.values())):
        return None
    histories = list(dict.fromkeys(f.channel for f in doubts if f.channel in record.channels))[:_HISTORIES]
    of_time = [f for f in doubts if f.channel == "time"]
    if of_time and not histories:
        histories = list(record.channels)[:1]
    if not histories:
        return None
    import matplotlib.style
    from matplotlib.figure import Figure

    owner = owner_of(histories[0])
    loop = [named(owner, channel) for channel in ("elongation", "force")]
    has_loop = {*loop} <= record.channels.keys()
    with matplotlib.style.context([_RC], after_reset=True):
        shown = [f for f in doubts if f.channel in (*histories, *loop, "time")]
        texts = [_text(finding) for finding in shown]
        lines = sum(1.2 + text.count("\n") for text in texts)
        figure = Figure(figsize=(7.0, 2.6 + 0.6 * (len(histories) - 1) + 0.14 * lines), layout="constrained")
        parts: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.25)) if has_loop else [None, figure]
        panels = list(np.atleast_1d(parts[1].subplots(len(histories), 1, sharex=True)))
        looks = {
            id(finding): look for finding, look in zip(doubts, _MARKS * (1 + len(doubts) // len(_MARKS)), strict=False)
        }
        for panel, channel in zip(panels, histories, strict=True):
            time, values = record.time, _declared(campaign, channel, record[channel])
            every = _every(len(record))
            panel.plot(_time(campaign, time[every]), values[every], **_LINE)
            for finding in doubts:
                if finding.channel in (channel, "time"):
                    _mark(panel, _time(campaign, time), values, finding, looks[id(finding)])
            panel.set_ylabel(_label(campaign, channel))
        panels[-1].set_xlabel(f"time [{campaign.unit('time').text}]" if campaign.has_time else "row")
        if has_loop:
            panel = parts[0].subplots()
            x, y = (_declared(campaign, channel, record[channel]) for channel in loop)
            every = _every(len(record))
            panel.plot(x[every], y[every], **_LINE)
            for finding in doubts:
                if finding.channel in (*loop, "time"):
                    _mark(panel, x, y, finding, looks[id(finding)])
            panel.set_xlabel(_label(campaign, loop[0]))
            panel.set_ylabel(_label(campaign, loop[1]))
        _explain(figure, experiment, shown, texts, looks)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=130, metadata={"Title": f"doubts of {experiment.id}"})
    return buffer.getvalue()


def _every(samples: int) -> slice:
    return slice(None, None, max(1, samples // _MOST))


def _declared(campaign: Campaign, channel: str, values: np.ndarray) -> np.ndarray:
    return np.asarray(campaign.unit(channel).from_si(values))


def _time(campaign: Campaign, time: np.ndarray) -> np.ndarray:
    return np.asarray(campaign.unit("time").from_si(time)) if campaign.has_time else time


def _label(campaign: Campaign, channel: str) -> str:
    return f"{campaign.pair.called(own_name(channel))} [{campaign.unit(channel).text}]"


def _mark(panel: Any, x: np.ndarray, y: np.ndarray, finding: Finding, look: _Look) -> None:
    """Mark the samples of a doubt: each sample if they are few, evenly spread ones if they are many."""
    rows = np.concatenate([np.arange(a, b) for a, b in finding.spans]) if finding.spans else np.empty(0, dtype=int)
    rows = rows[rows < x.size]
    if rows.size:
        rows = rows[:: max(1, rows.size // _SHOWN)]
        colour, form, size = look
        panel.plot(x[rows], y[rows], form, color=colour, markersize=size, fillstyle="none", zorder=2)


def _text(finding: Finding) -> str:
    whole = "" if finding.spans else " (the whole record)"
    text = f"{finding.kind}, {finding.channel}{whole}: {finding.message}"
    return "\n".join(textwrap.wrap(text, _WIDEST)).replace("$", r"\$")


def _explain(
    figure: Any, experiment: Experiment, doubts: Sequence[Finding], texts: list[str], looks: dict[int, _Look]
) -> None:
    """A text for each doubt, with its mark where it has one."""
    from matplotlib.lines import Line2D

    handles = []
    for finding in doubts:
        colour, form, size = looks[id(finding)]
        form = form if finding.spans else ""
        handles.append(Line2D([], [], color=colour, marker=form, linestyle="", markersize=size, fillstyle="none"))
    title = experiment.id.replace("$", r"\$")
    figure.legend(handles, texts, loc="outside upper left", frameon=False, fontsize=7, title=title, alignment="left")
