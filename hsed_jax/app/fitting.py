"""The second part of the page: start the run, watch it, stop it, continue it."""

import asyncio
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import panel as pn

from hsed_jax.app.jobs import Job
from hsed_jax.app.pieces import attempt, error, html, note, widget
from hsed_jax.app.session import Session
from hsed_jax.drafting.initial import text_of_study
from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.measurements import read_campaign

STEPS = {
    "fit, compare, find the missing effect, add it": "calibrate, compare, diagnose, improve",
    "fit and compare only": "calibrate, compare",
    "… and learn an effect that is not in the catalogue": "calibrate, compare, diagnose, discover, improve",
}
CARE = {
    "quick: a Gaussian around the best fit": "laplace",
    "careful: draws of the posterior (may take minutes longer)": "auto",
}
# Additions of the command line for users of a terminal.
_TYPED = ": say --resume to go on"
_FLAT: Any = {"margin": (8, 10), "styles": {"box-shadow": "none", "border": "1px solid #e3e5e9"}}
# Interval between two polls of the running process [s].
_LOOK = 0.3


class Fitting:
    """Start a run, follow it, stop it."""

    def __init__(self, session: Session):
        self._session = session
        self._followed: Job | None = None
        self._task: asyncio.Task | None = None
        self._messages, self._progress = html(), html()
        self._about, self._study = html(), html()
        self._steps = widget(pn.widgets.Select, name="what to do", options=STEPS, width=420)
        self._care = widget(pn.widgets.Select, name="how carefully", options=CARE, width=420)
        self._go = widget(pn.widgets.Button, name="Go", button_type="primary", disabled=True)
        self._go.on_click(self._start)
        self._stop = widget(pn.widgets.Button, name="Stop", disabled=True)
        self._stop.on_click(self._stopped)
        self._resume = widget(pn.widgets.Button, name="Go on where it stopped", visible=False)
        self._resume.on_click(self._resumed)
        text = pn.Card(
            self._study, title="the study that will be run", collapsed=True, sizing_mode="stretch_width", **_FLAT
        )
        self.view = pn.Column(
            self._about,
            pn.Row(self._steps, self._care),
            text,
            pn.Row(self._go, self._stop, self._resume),
            self._messages,
            self._progress,
            sizing_mode="stretch_width",
        )
        session.param.watch(self._take, "campaign")
        session.param.watch(self._attach, "run")
        self._describe("")

    async def follow(self, run: str, arguments: Sequence[str]) -> None:
        """Start a command that makes a run, and show its progress."""
        if (job := self._session.jobs.of(run)) is not None and job.status is None:
            return
        self._session.jobs.start(run, arguments)
        self._session.param.update(shown=1, run=run)
        await self._attach()

    def leave(self) -> None:
        """Stop following: the tab is closed, and the command continues."""
        self._followed = None

    def _describe(self, text: str) -> None:
        where = self._session.campaign
        about = f"Fit a model to <b>{escape(where)}</b>" if where else "Fit a model"
        said = (
            "A plain Bouc–Wen law with priors from your data. The report shows its error, where it fails, and the missing effect."
            if where
            else "Choose measurements first, in part 1, or open an existing run by its name above."
        )
        self._about.object = f"<h2>{about}</h2>{note(said)}"
        self._study.object = f"<pre>{escape(text)}</pre>" if text else note("There is none yet.")
        self._go.disabled = not text

    async def _take(self, event: Any) -> None:
        if not event.new:
            return
        self._messages.object = self._progress.object = ""
        text = await attempt(self._messages, self._text, self._session.folder.inside(event.new))
        self._describe(text or "")

    def _text(self, where: Path) -> str:
        return text_of_study(read_campaign(where), where, where / "study.yaml")

    async def _start(self, _: Any) -> None:
        self._go.disabled = True
        made = await attempt(self._messages, self._prepared)
        self._go.disabled = False
        if made is not None:
            study, run = made
            options = [f"steps=[{self._steps.value}]", f"calibration.sampler={self._care.value}"]
            await self.follow(run, ["run", study, "--output", run, *options])

    def _prepared(self) -> tuple[str, str]:
        """The study, written to a new file, and a run folder for it."""
        folder = self._session.folder
        where = folder.inside(self._session.campaign)
        text, study, number = self._text(where), folder.inside(where, "study.yaml"), 1
        while study.exists() and study.read_text(encoding="utf-8", errors="replace") != text:
            number += 1
            study = folder.inside(where, f"study-{number}.yaml")
        try:
            write_whole(study, text)
        except OSError as fault:
            raise UserError(f"{folder.name(study)}: cannot be written ({fault.strerror})") from None
        return folder.name(study), folder.name(folder.fresh("runs", where.name))

    def _stopped(self, _: Any) -> None:
        if self._followed is not None:
            self._stop.disabled = True
            self._followed.stop()

    async def _resumed(self, _: Any) -> None:
        run = self._session.run
        await self.follow(run, ["run", f"{run}/study.yaml", "--output", run, "--resume"])

    async def _attach(self, *_: Any) -> None:
        """Follow the command in the chosen run."""
        job = self._session.jobs.of(self._session.run)
        self._resume.visible = False
        if job is None or job.arguments[0] != "run":
            self._followed, self._progress.object, self._stop.disabled = None, "", True
            self._go.disabled = not self._session.campaign
            self._offer_resume()
        elif job is not self._followed:
            self._followed = job
            self._task = asyncio.create_task(self._watch(job))

    def _offer_resume(self) -> None:
        """An incomplete run can be continued, also one of an earlier day."""
        run = self._session.run
        folder = self._session.folder.inside(run) if run else None
        if folder is not None and (folder / "study.yaml").is_file() and not (folder / "report.html").is_file():
            self._resume.visible = True
            self._messages.object = note(f"{run} is not finished; nothing of it is lost.")

    async def _watch(self, job: Job) -> None:
        self._messages.object, self._stop.disabled, self._go.disabled = "", False, True
        while self._followed is job and job.status is None:
            self._progress.object = _progress(job, self._session.run)
            await asyncio.sleep(_LOOK)
        if self._followed is not job:
            return
        self._stop.disabled, self._go.disabled = True, not self._session.campaign
        self._progress.object = _progress(job, self._session.run)
        if job.status == 0:
            self._session.param.update(ended=self._session.ended + 1, shown=2)
        elif job.status == 3:
            self._messages.object = note((job.complaint or "stopped").replace(_TYPED, ""))
            self._resume.visible = True
        else:
            self._messages.object = error(job.complaint.removeprefix("error: ") or f"it ended with status {job.status}")


def _progress(job: Job, run: str) -> str:
    """The output of a command, and the progress of its current activity."""
    said = f"<pre>{escape(chr(10).join(job.said))}</pre>" if job.said else ""
    if job.status is not None:
        how = "done" if job.status == 0 else "stopped" if job.was_stopped else "ended"
        return f"<h2>{escape(run)}: {how}</h2>{said}"
    share = "" if job.share is None else f'<div class="bar"><div style="width:{job.share}%"></div></div>'
    percent = "" if job.share is None else f" ({job.share} %)"
    return f"<h2>{escape(run)} is running</h2><p>{escape(job.doing)}{percent}</p>{share}{said}"
