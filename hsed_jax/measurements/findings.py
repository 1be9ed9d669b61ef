"""A finding of a check of measured data: one fault, its place, and the setting that accepts it."""

import json
import re
from dataclasses import dataclass
from typing import Literal

DoubtKind = Literal[
    "unit",
    "constant",
    "gap",
    "jump",
    "clipped",
    "stuck",
    "noise",
    "offset",
    "sign",
    "timing",
    "drift",
    "slip",
    "hold",
    "monotonic",
    "copy",
    "overlap",
    "beyond",
]
"""Kinds of doubts, as `measurements.accept` of a study names it."""

# Ids that YAML reads back unchanged.
_PLAIN = re.compile(r"(?!(?:y|n|yes|no|on|off|true|false|null)$)[A-Za-z]\w*", re.IGNORECASE)


@dataclass(frozen=True)
class Finding:
    """One fault.

    Attributes:
        level: `error`: the data cannot be used so; `doubt`: they can, but somebody should look.
        experiment: Its id.
        channel: The channel or quantity.
        time: Its start [s]; the row if rows replace the time.
        message: The finding in words.
        kind: Kind of the doubt; None for an error.
        has_time: Whether the records have a time.
        spans: Affected samples of the record, each the first and one after the last; empty for the whole record.
    """

    level: Literal["error", "doubt"]
    experiment: str
    channel: str
    time: float | None
    message: str
    kind: DoubtKind | None = None
    has_time: bool = True
    spans: tuple[tuple[int, int], ...] = ()

    @property
    def line(self) -> str:
        """The finding as one line, without the setting that accepts it."""
        when = "" if self.time is None else f", t = {self.time:g} s" if self.has_time else f", row {self.time:.0f}"
        return f"{self.level}: {self.experiment}, {self.channel}{when}: {self.message}"

    @property
    def setting(self) -> str:
        """The setting that accepts a doubt, as a key of `measurements` of a study; empty for an error."""
        return "" if self.kind is None else f"accept: {{{yaml_key(self.experiment)}: {self.kind}}}"

    def __str__(self) -> str:
        """Return the finding as one line, with the setting that accepts it."""
        return f"{self.line} [{self.setting}]" if self.setting else self.line


def yaml_key(id: str) -> str:
    """An id as YAML reads it back."""
    return id if _PLAIN.fullmatch(id) else json.dumps(id)
