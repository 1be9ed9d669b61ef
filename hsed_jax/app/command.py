"""The command `hsed app`: parsing and output only."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hsed_jax.errors import UserError


def add_command(commands: Any) -> None:
    """Add the command to the sub-commands of `hsed`."""
    text = "a local page in the browser: drop a file, choose units, fit, read, play with effects"
    app = commands.add_parser("app", help=text, description=text[0].upper() + text[1:] + ".")
    app.add_argument(
        "folder",
        nargs="?",
        default=".",
        metavar="FOLDER",
        help="folder of all files that it reads and writes (default: the current one)",
    )
    app.add_argument("--port", type=int, default=0, metavar="N", help="port of the page (default: any free port)")
    app.add_argument("--no-browser", action="store_true", help="print the address without opening a browser")
    app.set_defaults(command=_app)


def _app(options: Any) -> int:
    if missing := [name for name in ("panel", "openpyxl") if find_spec(name) is None]:
        raise UserError(f"hsed app needs {' and '.join(missing)}; install it with: pip install 'hsed_jax[app]'")
    from hsed_jax.app.server import serve

    stopped = serve(Path(options.folder), options.port, not options.no_browser)
    if stopped:
        print(f"stopped the running command ({stopped}); nothing is lost: open the page again to go on")
    return 0
