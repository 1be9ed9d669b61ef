"""The page of one tab: its parts, and the run that they show."""

from html import escape
from typing import Any

import panel as pn

from hsed_jax.app.asking import Asking
from hsed_jax.app.effects import Effects
from hsed_jax.app.fitting import Fitting
from hsed_jax.app.folder import Folder
from hsed_jax.app.jobs import Jobs
from hsed_jax.app.measured import Measured
from hsed_jax.app.outcome import Download, Report
from hsed_jax.app.pieces import WIDGETS, html, widget
from hsed_jax.app.session import Session


class Page:
    """The content of one tab.

    Arguments:
        folder, jobs: of the server; nothing else is shared with other tabs.
    """

    def __init__(self, folder: Folder, jobs: Jobs):
        self._session = session = Session(folder, jobs)
        fitting = Fitting(session)
        pn.state.on_session_destroyed(lambda context: fitting.leave())
        self._runs = widget(pn.widgets.Select, name="run", width=330)
        self._runs.param.watch(lambda event: session.param.update(run=event.new), "value")
        session.param.watch(self._list, ["run", "ended"])
        self._list()
        parts = {
            "1 Measurements": Measured(session).view,
            "2 Fit": fitting.view,
            "3 Report": Report(session).view,
            "4 Effects": Effects(session, fitting).view,
            "5 Next experiment": Asking(session).view,
            "6 Download": Download(session).view,
        }
        tabs = pn.Tabs(*parts.items(), sizing_mode="stretch_width", stylesheets=[WIDGETS])
        tabs.link(session, active="shown", bidirectional=True)
        head = html(
            f'<p class="brand">hsed_jax</p><h1>From a test to a model</h1><p class="note">{escape(str(folder.root))}</p>'
        )
        self.view = pn.Column(
            pn.Row(head, self._runs, sizing_mode="stretch_width"),
            tabs,
            sizing_mode="stretch_width",
            max_width=1120,
            styles={"margin": "0 auto", "padding": "0 1rem"},
        )

    def _list(self, *_: Any) -> None:
        """The runs of the folder, and the chosen one."""
        run, known = self._session.run, self._session.folder.runs()
        # One that has just been started has no folder yet.
        self._runs.options = {"(none)": ""} | {name: name for name in dict.fromkeys([*([run] if run else []), *known])}
        self._runs.value = run
