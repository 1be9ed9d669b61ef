"""The state of a tab; tabs share nothing."""

from typing import Any

import param

from hsed_jax.app.folder import Folder
from hsed_jax.app.jobs import Jobs


class Session(param.Parameterized):
    """The state of a tab.

    Attributes:
        folder, jobs: of the server.
    """

    campaign = param.String(doc="Folder of the measurements, within the folder of the page; empty: not yet chosen.")
    run = param.String(doc="The run folder that is looked at; empty: none.")
    ended = param.Integer(0, doc="How many commands ended that this tab followed: what they left is to be read again.")
    shown = param.Integer(0, doc="The part of the page that is shown.")

    def __init__(self, folder: Folder, jobs: Jobs, **state: Any):
        super().__init__(**state)
        self.folder, self.jobs = folder, jobs
