"""The results of a run: its report, and the files for download."""

from abc import abstractmethod
from html import escape
from typing import Any
from urllib.parse import quote

from hsed_jax.app.folder import OFFERED
from hsed_jax.app.pieces import NONE_YET, html, note
from hsed_jax.app.session import Session

_WHAT = {
    "report.html": "the report: one page that needs no other file",
    "study.yaml": "the study of this run with every default written out",
    "improved.yaml": "the improved model: the study with the missing effects, ready to run",
    "summary.json": "numbers of the run, for programs",
    "results.nc": "draws and predictions (NetCDF)",
    "learned_effect.py": "the learned effect as Python code",
}


def address(run: str, name: str) -> str:
    """The address of a file of a run, relative to the page, which ends in a slash."""
    return f"files/{quote(run)}/{name}"


class _OfRun:
    """A part of the page about the chosen run; it is drawn again when the run changes or ends."""

    def __init__(self, session: Session):
        self._session = session
        self.view = html(NONE_YET)
        session.param.watch(self._show, ["run", "ended"])

    def _show(self, *_: Any) -> None:
        run = self._session.run
        self.view.object = self._shown(run) if run else NONE_YET

    @abstractmethod
    def _shown(self, run: str) -> str:
        """The text on a run."""


class Report(_OfRun):
    """The page that `hsed report` writes."""

    def _shown(self, run: str) -> str:
        if not (self._session.folder.inside(run) / "report.html").is_file():
            return note("The run has no report yet; it is written at its end.")
        # A changed file has a new address, so that the browser does not show a cached page.
        where = f"{address(run, 'report.html')}?{self._session.ended}"
        about = f'title="report of {escape(run)}" sandbox="allow-scripts allow-downloads"'
        return f'<iframe {about} src="{where}"></iframe>'


class Download(_OfRun):
    """Files of a run to keep."""

    def _shown(self, run: str) -> str:
        folder = self._session.folder.inside(run)
        rows = [
            f'<tr><td><a href="{address(run, name)}?download" download="{escape(folder.name)}-{name}">{name}</a></td>'
            f"<td>{_WHAT[name]}</td></tr>"
            for name in OFFERED
            if (folder / name).is_file()
        ]
        where = note(f"They are also in {folder}, with the figures and the journal.")
        return f"<h2>Files of this run</h2><table>{''.join(rows)}</table>{where}"
