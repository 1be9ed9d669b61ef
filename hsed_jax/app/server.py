"""The server of the page: on this machine alone, behind a token, for as many tabs as there are.

All addresses are below the token: pages, scripts, the connection of a tab, files of runs. Other addresses are not found.
"""

import asyncio
import secrets
import signal
import socket
import webbrowser
from pathlib import Path
from typing import Any

import panel as pn
from bokeh.server.server import Server
from panel.io.server import get_server
from tornado.web import HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError

from hsed_jax.app.folder import Folder
from hsed_jax.app.jobs import Jobs
from hsed_jax.app.page import Page
from hsed_jax.errors import UserError

ADDRESS = "127.0.0.1"
# Size of one message [bytes]; a dropped file arrives in several messages.
_MESSAGE = 64 * 1024**2
_CHUNK = 1024**2
_SAFE = {
    # A report is code, too: it runs, and reaches neither the page around it nor the network.
    "Content-Security-Policy": "sandbox allow-scripts allow-downloads; default-src 'unsafe-inline' 'unsafe-eval' data: blob:",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
_TYPES = {".html": "text/html; charset=utf-8", ".yaml": "text/yaml; charset=utf-8", ".json": "application/json"}


class RunFile(RequestHandler):
    """Serves files of runs."""

    def initialize(self, folder: Folder) -> None:
        """Receive the state of the server."""
        self._folder = folder

    async def get(self, run: str, name: str) -> None:
        """A file of a run, to be looked at or, with `?download`, to be kept."""
        try:
            path = self._folder.handed_out(run, name)
        except UserError as error:
            raise HTTPError(404, reason="Not Found", log_message=str(error)) from None
        for header, value in _SAFE.items():
            self.set_header(header, value)
        self.set_header("Content-Type", _TYPES.get(path.suffix, "application/octet-stream"))
        if self.get_query_argument("download", None) is not None:
            self.set_header("Content-Disposition", "attachment")
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK):
                self.write(chunk)
                await self.flush()


class _NoIcon(RequestHandler):
    def get(self) -> None:
        self.set_status(204)


def serve(root: Path, port: int, opens: bool) -> int:
    """Serve the page until Ctrl-C or a termination, and print its address.

    Arguments:
        root: the folder that it may read and write.
        port: of the server; 0: any free port.
        opens: whether to open it in the browser.

    Returns:
        How many commands were running and were stopped.

    Raises:
        UserError: there is no such folder, or the port is taken.
    """
    folder = Folder(root)
    jobs = Jobs(folder.root)
    asyncio.run(_until_stopped(folder, jobs, port, opens))
    return jobs.stop()


async def _until_stopped(folder: Folder, jobs: Jobs, port: int, opens: bool) -> None:
    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    server, address = made(folder, jobs, port)
    loop.set_exception_handler(say_unless_tab_closed)
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    server.start()
    print(
        f"hsed app serves {folder.root}\n  {address}\nopen it in a browser on this machine; Ctrl-C ends it", flush=True
    )
    if opens:
        webbrowser.open(address)
    await stopped.wait()
    server.stop()


def say_unless_tab_closed(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report an error of a task that nobody awaits, unless a tab was closed while the server wrote to it."""
    # Panel does not await all messages of a session that it destroys; a closed tab is no fault.
    if not isinstance(context.get("exception"), WebSocketClosedError):
        loop.default_exception_handler(context)


def made(folder: Folder, jobs: Jobs, port: int) -> tuple[Server, str]:
    """The server of the running event loop, not yet started, and the address of the page.

    Raises:
        UserError: the port is taken.
    """
    token, port = secrets.token_urlsafe(24), _free(port)
    pn.extension("filedropper", notifications=False)
    server = get_server(
        {"/": lambda: Page(folder, jobs).view},
        port=port,
        address=ADDRESS,
        prefix=f"/{token}",
        websocket_origin=f"{ADDRESS}:{port}",
        websocket_max_message_size=_MESSAGE,
        extra_patterns=[(r"/files/(.+)/([^/]+)", RunFile, {"folder": folder}), (r"/favicon\.ico", _NoIcon)],
        ico_path="none",
        title="hsed",
    )
    return server, f"http://{ADDRESS}:{port}/{token}/"


def _free(port: int) -> int:
    """The port, or a free one: the allowed origins of a connection contain its number."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((ADDRESS, port))
        except (OSError, OverflowError):
            raise UserError(f"--port {port}: it is taken or no port; choose another one, or leave it out") from None
        return probe.getsockname()[1]
