"""The progress of a step on the terminal, and its saved state in the run folder."""

import sys
import threading
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import numpy as np
from tqdm import tqdm

from hsed_jax.criticism.compare import normalised_error
from hsed_jax.criticism.prediction import error_cell
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.watch import Watch
from hsed_jax.runs.folder import RunFolder

_PLAIN = "{desc} [{elapsed}]{postfix}"
_COUNTED = "{desc}: {percentage:3.0f}% |{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}]{postfix}"


class Progress(Watch):
    """Follows a step of a run.

    Arguments:
        step: its name.
        show: on the standard error; if it is not a terminal, from time to time.
        store: the run folder; without one nothing is stored.

    Attributes:
        leading: the best result so far, in the words of `summary.json`.
    """

    def __init__(self, step: str, show: bool, store: RunFolder | None = None):
        self._step, self._store = step, store
        self.leading: dict[str, Any] = {}
        is_seen = sys.stderr.isatty()
        self._bar = tqdm(desc=step, bar_format=_PLAIN, disable=not show, mininterval=0.1 if is_seen else 10.0)
        self._ended = threading.Event()
        if show and is_seen:
            # A clock that also runs during a single compiled call.
            threading.Thread(target=self._tick, daemon=True).start()

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None):
        self._ended.set()
        self._bar.close()

    def report(self, what: str) -> None:
        """Show the current activity."""
        if not self._bar.disable:
            self._bar.bar_format = _PLAIN
            self._bar.set_description_str(f"{self._step}: {what}")

    def count(self, done: int, total: int) -> None:
        """Show the completed share, and the estimated remaining time."""
        if self._bar.disable:
            return
        if self._bar.bar_format == _PLAIN or total != self._bar.total or done < self._bar.n:
            self._bar.bar_format = _COUNTED
            self._bar.reset(total)
        self._bar.update(done - self._bar.n)

    def lead(self, content: dict[str, Any]) -> None:
        """Show the leading explanation with its error, for the summary of a run that is interrupted."""
        self.leading = content
        if not self._bar.disable:
            before, after = content["error"]["before"], content["error"]["after"]
            named = " + ".join(content["effects"]) or "no effect"
            self._bar.set_postfix_str(f"so far {named}: error {before:.3f} -> {after:.3f}")

    def fitted(self, predicted: np.ndarray, data: Data, groups: np.ndarray) -> None:
        """Print the error of the most probable parameters before the draws are made."""
        if not self._bar.disable:
            count = int(data.count)
            used = np.asarray(data.weights)[:count] > 0
            error = normalised_error(np.asarray(data.values)[:count], predicted[:count], used, groups)
            self._bar.write(
                f"{self._step}: the error on the fitted experiments is {error_cell(error)} at the most probable parameters; "
                "their uncertainty follows"
            )

    def keep(self, name: str, arrays: Sequence[np.ndarray]) -> None:
        """Store a state in the run folder."""
        if self._store is not None:
            self._store.keep(name, arrays)

    def recall(self, name: str) -> list[np.ndarray] | None:
        """The state that an earlier session of the run stored."""
        return None if self._store is None else self._store.recall(name)

    def _tick(self) -> None:
        while not self._ended.wait(1.0):
            self._bar.refresh()
