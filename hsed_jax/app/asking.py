"""The part of the page that asks for the next experiment, and takes its measurements."""

import asyncio
import json
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import panel as pn

from hsed_jax.app.drops import DROPPED, landed
from hsed_jax.app.jobs import Job
from hsed_jax.app.pieces import attempt, error, html, note, widget
from hsed_jax.app.session import Session
from hsed_jax.errors import UserError
from hsed_jax.plain import parse_yaml

_LOOK = 0.3
# How `hsed ask` ends what it prints about an experiment.
_THEN = re.compile(r"then: hsed tell \S+ '?([^']+)'?$")
_NO_DESIGN = (
    "There is no design among the steps of this study, which are {}. A design needs inputs with their ranges, an excitation that "
    "follows from them, and somebody who performs it (docs/laboratories.md); a measured record gives none of these."
)
_DESIGN = (
    "A design chooses the experiment from which the model is expected to learn most. The request, with the response that the "
    "model expects, is written into the run folder."
)


class _Askable(NamedTuple):
    """Studies and runs with a possible next experiment, by name; the reason if a run has none; the proposal of its
    diagnosis.
    """

    designs: list[str]
    why_not: str
    wanted: str


class Asking:
    """Request the next experiment of a study with a design, and read its record."""

    def __init__(self, session: Session):
        self._session = session
        self._about, self._faults, self._messages = html(), html(), html()
        self._design = widget(pn.widgets.Select, name="design", width=420)
        self._ask = widget(pn.widgets.Button, name="Ask for the next experiment", button_type="primary")
        self._ask.on_click(self._asked)
        self._id = widget(pn.widgets.Select, name="experiment that was performed", width=220)
        self._record = pn.Column(sizing_mode="stretch_width")
        self._told = pn.Column(
            html("<p>When it has been performed, drop its record here, with the columns that the study names.</p>"),
            self._id,
            self._record,
            sizing_mode="stretch_width",
            visible=False,
        )
        self._can = pn.Column(self._design, self._ask, visible=False)
        self.view = pn.Column(
            self._about, self._faults, self._can, self._messages, self._told, sizing_mode="stretch_width"
        )
        session.param.watch(self._show, ["run", "ended", "shown"])

    async def _show(self, *_: Any) -> None:
        if self._session.shown != 4:
            return
        found = await attempt(self._faults, self._askable)
        if found is None:
            return
        self._can.visible = bool(found.designs)
        before = self._design.value
        self._design.options = found.designs
        if before in found.designs:
            self._design.value = before
        lines = [found.why_not, _DESIGN if found.designs else ""]
        said = "".join(f"<p>{escape(line)}</p>" for line in lines if line)
        self._about.object = f"<h2>Which experiment next?</h2>{said}{note(found.wanted) if found.wanted else ''}"

    def _askable(self) -> _Askable:
        run, folder = self._session.run, self._session.folder
        designs = [folder.name(path) for path in folder.studies() if "design" in _steps(path)]
        if not run:
            why = "" if designs else "There is no run yet, and no study with a design in this folder."
            return _Askable(designs, why, "")
        steps = _steps(folder.inside(run, "study.yaml"))
        if "design" in steps:
            return _Askable([run, *designs], "", "")
        try:
            summary = json.loads((folder.inside(run) / "summary.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            summary = {}
        wanted = ", ".join(
            f"{name} {value:.4g}" for name, value in (summary.get("diagnosis", {}).get("next_experiment") or {}).items()
        )
        said = f"An experiment at {wanted} separates the explanations of the diagnosis best." if wanted else ""
        return _Askable(designs, _NO_DESIGN.format(", ".join(steps)), said)

    async def _asked(self, _: Any) -> None:
        chosen, folder = str(self._design.value), self._session.folder
        path = folder.inside(chosen)
        if path.is_dir():
            run, arguments = folder.name(path), ["ask", chosen]
        else:
            run = folder.name(folder.inside("runs", path.stem))
            arguments = ["ask", chosen, "--output", run]
        self._messages.object = note("choosing the next experiment from the measurements so far …")
        job = await self._done(run, arguments)
        if job is None:
            return
        ids = [found[1] for line in job.said if (found := _THEN.search(line))]
        said = [line for line in job.said if not _THEN.search(line)]
        self._messages.object = f"<pre>{escape(chr(10).join(said))}</pre>"
        self._id.options, self._told.visible = ids, bool(ids)
        self._fresh_dropper()
        self._session.run = run

    def _fresh_dropper(self) -> None:
        dropper = widget(pn.widgets.FileDropper, sizing_mode="stretch_width", min_height=90)
        dropper.param.watch(self._dropped, "value")
        self._record[:] = [dropper]

    async def _dropped(self, event: Any) -> None:
        if not event.new:
            return
        run, id = self._session.run, str(self._id.value)
        ((name, content),) = event.new.items()
        files = {name: content.encode() if isinstance(content, str) else content}
        where = await attempt(self._messages, landed, self._session.folder, files)
        if where is None:
            return
        path = self._session.folder.name(where / DROPPED / name)
        self._messages.object = note(f"reading the measurements of {id} …")
        job = await self._done(run, ["tell", run, id, "--record", path])
        self._fresh_dropper()
        if job is not None:
            self._told.visible = False
            self._messages.object = f"<pre>{escape(chr(10).join(job.said))}</pre>"

    async def _done(self, run: str, arguments: Sequence[str]) -> Job | None:
        """A completed command in a run; None with a shown message if it failed."""
        jobs = self._session.jobs
        if (job := jobs.of(run)) is not None and job.status is None:
            self._messages.object = note("Another command uses this run; wait until it ends.")
            return None
        self._ask.disabled = True
        job = jobs.start(run, arguments)
        while job.status is None:
            await asyncio.sleep(_LOOK)
        self._ask.disabled = False
        if job.status == 0:
            return job
        self._messages.object = error(job.complaint.removeprefix("error: "))
        return None


def _steps(path: Path) -> list[str]:
    """The steps of a study; empty if the file is not a study."""
    try:
        study = parse_yaml(path.read_text(encoding="utf-8"), path.name)
        return [str(step) for step in study["steps"]] if {"study", "experiments"} <= study.keys() else []
    except (OSError, UnicodeDecodeError, UserError, KeyError, TypeError, AttributeError):
        return []
