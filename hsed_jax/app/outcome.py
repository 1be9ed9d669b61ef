"""The last parts of the page: the report of a run, the next experiment, and what can be taken away."""

import asyncio
import json
from html import escape
from typing import Any
from urllib.parse import quote

import panel as pn

from hsed_jax.app.folder import OFFERED
from hsed_jax.app.pieces import attempt, error, html, note, widget
from hsed_jax.app.session import Session
from hsed_jax.errors import UserError
from hsed_jax.plain import parse_yaml

_WHAT = {
    "report.html": "the report, one page that needs nothing else",
    "study.yaml": "the study as it was run, every default written out",
    "improved.yaml": "the improved model: the study with the missing effects in it, ready to run",
    "summary.json": "numbers of the run, for programs",
    "results.nc": "draws and predictions (NetCDF)",
    "learned_effect.py": "the effect that was learned, as Python code",
}
_LOOK = 0.3


def address(run: str, name: str) -> str:
    """Where the page, which ends in a slash, finds a file of a run."""
    return f"files/{quote(run)}/{name}"


class Report:
    """The page that `hsed report` writes."""

    def __init__(self, session: Session):
        self._session = session
        self.view = html(note("There is no run yet."))
        session.param.watch(self._show, ["run", "ended"])

    def _show(self, *_: Any) -> None:
        run = self._session.run
        if not run:
            self.view.object = note("There is no run yet.")
        elif (self._session.folder.inside(run) / "report.html").is_file():
            # What has changed has another address, so that a page that is kept is not shown for it.
            where = f"{address(run, 'report.html')}?{self._session.ended}"
            about = f'title="report of {escape(run)}" sandbox="allow-scripts allow-downloads"'
            self.view.object = f'<iframe {about} src="{where}"></iframe>'
        else:
            self.view.object = note("The run has no report yet; it is written at its end.")


class Download:
    """Files of a run to keep."""

    def __init__(self, session: Session):
        self._session = session
        self.view = html(note("There is no run yet."))
        session.param.watch(self._show, ["run", "ended"])

    def _show(self, *_: Any) -> None:
        run = self._session.run
        if not run:
            self.view.object = note("There is no run yet.")
            return
        folder = self._session.folder.inside(run)
        rows = [
            f'<tr><td><a href="{address(run, name)}?download" download="{escape(folder.name)}-{name}">{name}</a></td>'
            f"<td>{_WHAT[name]}</td></tr>"
            for name in OFFERED
            if (folder / name).is_file()
        ]
        where = note(f"They lie in {folder}, too, beside the figures and the journal.")
        self.view.object = f"<h2>Files of this run</h2><table>{''.join(rows)}</table>{where}"


class Next:
    """Ask for the next experiment, where the study has a design."""

    def __init__(self, session: Session):
        self._session = session
        self._about, self._messages = html(note("There is no run yet.")), html()
        self._ask = widget(pn.widgets.Button, name="Ask for the next experiment", button_type="primary", visible=False)
        self._ask.on_click(self._asked)
        self.view = pn.Column(self._about, self._ask, self._messages, sizing_mode="stretch_width")
        session.param.watch(self._show, ["run", "ended"])

    async def _show(self, *_: Any) -> None:
        run = self._session.run
        self._messages.object, self._ask.visible = "", False
        if not run:
            self._about.object = note("There is no run yet.")
            return
        found = await attempt(self._messages, self._why_not, run)
        if found is not None:
            why, separates = found
            self._ask.visible = not why
            said = why or (
                "The study has a design: it chooses the experiment that is expected to teach the model most. "
                "The request, with what the model expects, is written into the run folder."
            )
            self._about.object = (
                f"<h2>Which experiment next?</h2><p>{escape(said)}</p>{note(separates) if separates else ''}"
            )

    def _why_not(self, run: str) -> tuple[str, str]:
        """Why no experiment can be asked for, empty where one can; and the experiment that a diagnosis would like."""
        folder = self._session.folder.inside(run)
        try:
            study = parse_yaml((folder / "study.yaml").read_text(encoding="utf-8"), f"{run}/study.yaml")
            steps = list(study["steps"])
        except (OSError, KeyError, TypeError):
            raise UserError(f"{run}/study.yaml: it is damaged or missing") from None
        why = ""
        if "design" not in steps:
            why = (
                f"There is no design among the steps of this study, which are {', '.join(steps)}. A design needs "
                "inputs with their ranges, an excitation that follows from them, and somebody who performs it "
                "(docs/laboratories.md); a record that was measured tells none of these."
            )
        try:
            summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            summary = {}
        wanted = summary.get("diagnosis", {}).get("next_experiment")
        if not wanted:
            return why, ""
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in wanted.items())
        return why, f"What tells the explanations of the diagnosis apart best is an experiment at {numbers}."

    async def _asked(self, _: Any) -> None:
        run = self._session.folder.name(self._session.folder.inside(self._session.run))
        if (job := self._session.jobs.of(run)) is not None and job.status is None:
            self._messages.object = note("A command is at work in this run; wait for its end.")
            return
        self._ask.disabled = True
        self._messages.object = note("asking: what was measured so far is calibrated and searched …")
        job = self._session.jobs.start(run, ["ask", run])
        while job.status is None:
            await asyncio.sleep(_LOOK)
        self._ask.disabled = False
        if job.status == 0:
            self._messages.object = f"<pre>{escape(chr(10).join(job.said))}</pre>"
        else:
            self._messages.object = error(job.complaint.removeprefix("error: "))
