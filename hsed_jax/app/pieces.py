"""The building blocks of the page: text in the style of the reports, messages, the figure with the loops."""

import asyncio
import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure

from hsed_jax.errors import UserError
from hsed_jax.reporting.style import BLACK, BLUE

CSS = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
WIDGETS = """
:host { font: 15px/1.4 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
.bk-btn { border-radius: .35rem; font: inherit; padding: .4rem .9rem; }
.bk-btn-primary { background: #0068ad; border-color: #0068ad; }
label, .bk-slider-title { color: #1a1c20; }
.bk-tab { font-size: 15px; padding: .45rem .8rem; color: #6b7280; border: 0; }
.bk-tab.bk-active { color: #0068ad; border: 0; border-bottom: 3px solid #0068ad; }
.noUi-connect { background: #0068ad; }
"""
# A line on a screen shows no more.
_POINTS = 6000
_LOG = logging.getLogger("hsed_jax.app")


def html(text: str = "", **settings: Any) -> pn.pane.HTML:
    """A piece of text in the style of the reports."""
    return pn.pane.HTML(text, stylesheets=[CSS], sizing_mode="stretch_width", **settings)


def error(message: str) -> str:
    """An error message."""
    return f'<div class="error" role="alert">{escape(message)}</div>'


def warnings(lines: Iterable[str]) -> str:
    """A list of doubts; nothing without doubts."""
    said = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<div class="warnings" role="status"><ul>{said}</ul></div>' if said else ""


def note(text: str) -> str:
    """A remark."""
    return f'<p class="note">{escape(text)}</p>'


NONE_YET = note("There is no run yet: choose measurements in part 1 and fit a model to them in part 2.")


def widget(kind: Callable[..., Any], **settings: Any) -> Any:
    """A widget in the style of the page."""
    return kind(stylesheets=[WIDGETS], **settings)


@contextmanager
def told(messages: pn.pane.HTML) -> Iterator[None]:
    """A context in which a mistake of the user, or a defect of the package, is shown instead of raised."""
    try:
        yield
    except UserError as mistake:
        messages.object = error(str(mistake))
    except Exception as defect:
        _LOG.exception("a defect of the page")
        messages.object = error(
            f"a defect of the page: {type(defect).__name__}: {defect}; the completed work is in the folder"
        )


async def attempt(messages: pn.pane.HTML, work: Callable[..., Any], *arguments: Any) -> Any:
    """Perform a long operation on a thread, with `told`.

    Returns:
        Its result; None if it failed.
    """
    with told(messages):
        found = await asyncio.to_thread(work, *arguments)
        messages.object = ""
        return found
    return None


class Loops:
    """The loops of experiments, and the prediction of a model over one of them."""

    def __init__(self, *, has_model: bool, height: int = 400):
        self._measured, self._predicted = ColumnDataSource({"x": [], "y": []}), ColumnDataSource({"x": [], "y": []})
        plot = figure(
            height=height, sizing_mode="stretch_width", tools="pan,wheel_zoom,box_zoom,reset", output_backend="canvas"
        )
        plot.toolbar.logo = None
        plot.line("x", "y", source=self._predicted, color=BLUE, line_width=2.2, legend_label="model")
        # As in the figures of a report, a measurement is a dashed line above the line of a model.
        looks: dict[str, Any] = {"line_dash": [5, 2]} if has_model else {}
        plot.multi_line("x", "y", source=self._measured, color=BLACK, line_width=1.2, legend_label="measured", **looks)
        plot.legend.visible = has_model
        for axis in (plot.xaxis, plot.yaxis):
            axis.axis_label_text_font_style = "normal"
            axis.axis_label_text_font_size = axis.major_label_text_font_size = "13px"
        plot.grid.grid_line_color = "#e3e5e9"
        plot.outline_line_color = None
        plot.legend.location, plot.legend.border_line_color = "top_left", None
        plot.legend.background_fill_alpha = 0.7
        self._plot = plot
        self.pane = pn.pane.Bokeh(plot, sizing_mode="stretch_width", height=height)

    def show(self, is_shown: bool) -> None:
        """Show or hide the figure."""

        def change() -> None:
            self.pane.visible = is_shown

        self._with_lock(change)

    def measured(self, loops: Iterable[tuple[np.ndarray, np.ndarray]], x: str, y: str) -> None:
        """Draw the measurements, x and y of each record, and label the axes."""
        drawn = [(_thinned(x), _thinned(y)) for x, y in loops]

        def change() -> None:
            self._plot.xaxis.axis_label, self._plot.yaxis.axis_label = x, y
            self._measured.data = {"x": [x for x, _ in drawn], "y": [y for _, y in drawn]}

        self._with_lock(change)

    def predicted(self, x: np.ndarray, y: np.ndarray) -> None:
        """Draw the prediction of a model."""

        def change() -> None:
            self._predicted.data = {"x": _thinned(x), "y": _thinned(y)}

        self._with_lock(change)

    def _with_lock(self, change: Callable[[], None]) -> None:
        """Change the figure as bokeh requires: if a tab already shows it, at a time when nothing else changes that tab."""
        document = self._plot.document
        if document is None:
            change()
        else:
            document.add_next_tick_callback(change)


def _thinned(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, len(values) // _POINTS)]
