"""The files of figures, which a second process writes while this one draws the next figure.

The two files of a figure take more time than its drawing, and one process of Python uses one core.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import wraps
from pathlib import Path
from types import TracebackType

import matplotlib.style
from matplotlib.figure import Figure

from hsed_jax.drafts import create

_RC = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that a figure looks the same everywhere
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.limits": (-3, 4),
    "axes.spines.top": False,
    "axes.spines.right": False,
    # The place that matplotlib finds in each drawing: no panel has ticks above it.
    "axes.titley": 1.0,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.markersize": 3.5,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "svg.fonttype": "none",  # text stays text: searchable, and read aloud by screen readers
    "svg.hashsalt": "hsed_jax",  # the same figure is the same file
}


def in_house_style[**P, R](draw: Callable[P, R]) -> Callable[P, R]:
    """Run a drawing function under the house style, and restore the user's settings of matplotlib."""

    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.style.context([_RC], after_reset=True):
            return draw(*args, **kwargs)

    return styled


@in_house_style
def write(figure: Figure, title: str, description: str, folder: Path, name: str) -> tuple[Path, Path]:
    """Write `name.png` (200 dpi) and `name.svg` into a folder, and return their paths.

    The same figure gives the same bytes: no date, fixed identifiers.  Title and description are in the metadata of both files.

    Raises:
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    about = {"Title": title, "Description": description}
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"
    with create(png) as file:
        # A level of compression whose files are a tenth larger, in a third of the time.
        figure.savefig(file, format="png", dpi=200, metadata=about, pil_kwargs={"compress_level": 3})
    with create(svg) as file:
        figure.savefig(file, format="svg", dpi=200, metadata={**about, "Date": None})
    return png, svg


class Writer:
    """A process that writes figures one after another; it ends with this object, and with this process."""

    def __init__(self) -> None:
        # The package from the same place, and nothing from the current folder.
        paths = filter(None, [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")])
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # Ctrl-C at the terminal is ours to handle
        )
        self._thread = ThreadPoolExecutor(1)

    def write(self, figure: Figure, title: str, description: str, folder: Path, name: str) -> "Future[None]":
        """Let the process write a figure as `write` does.  The future ends when both files exist, or with the error."""
        return self._thread.submit(self._asked, pickle.dumps((figure, title, description, folder, name)))

    def _asked(self, request: bytes) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(request)
            self._process.stdin.flush()
            error = pickle.load(self._process.stdout)
        except (BrokenPipeError, EOFError):
            raise RuntimeError("the process that writes figures has ended") from None
        if error is not None:
            raise error

    def __enter__(self) -> "Writer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._process.kill()
        self._thread.shutdown(cancel_futures=True)
        self._process.communicate()


def _serve() -> None:
    """Write the figures that come on the standard input, and answer with the error of each, or with None."""
    # What a library prints must not be among the answers.
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    while True:
        try:
            asked = pickle.load(requests)
        except EOFError:
            return
        try:
            write(*asked)
            error = None
        except Exception as fault:
            error = fault
        answers.write(pickle.dumps(error))
        answers.flush()


if __name__ == "__main__":
    import matplotlib.backends.backend_agg
    import matplotlib.backends.backend_svg

    _serve()
