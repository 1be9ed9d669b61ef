"""A small table for readers: the same sentence, rows and notes as text in a terminal and as HTML in a notebook."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

MOST = 12
"""Number of shown rows; of longer tables, the number of the others is stated."""

_NUMBER = re.compile(r"[+\-−]?[\d.].*|–?")


@dataclass(frozen=True)
class Table:
    """The displayed text of an object.

    Attributes:
        sentence: main result, before the table.
        heads: of the columns; empty if the first column names the contents of the others.
        rows: cells, all rows of one length.
        notes: sentences after the table.
    """

    sentence: str
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    notes: Sequence[str] = ()

    def __str__(self) -> str:
        lines = [*([self.heads] if self.heads else []), *self.rows[:MOST]] if self.rows else []
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        placed = [
            [c.rjust(w) if right else c.ljust(w) for c, w, right in zip(line, widths, self._right, strict=True)]
            for line in lines
        ]
        return "\n".join([self.sentence, *("  ".join(line).rstrip() for line in placed), *self._after])

    def html(self) -> str:
        """The table as HTML without a colour of its own, so that it suits light and dark pages."""
        # A notebook's own style turns every cell to the right, other pages to the left.
        sides = [f' style="text-align:{"right" if right else "left"}"' for right in self._right]

        def line(cells: Sequence[str], tag: str) -> str:
            marked = (f"<{tag}{side}>{escape(c)}</{tag}>" for c, side in zip(cells, sides, strict=True))
            return f"<tr>{''.join(marked)}</tr>"

        head = f"<thead>{line(self.heads, 'th')}</thead>" if self.rows and self.heads else ""
        body = "".join(line(row, "td") for row in self.rows[:MOST])
        table = f"<table>{head}<tbody>{body}</tbody></table>" if body else ""
        first, *after = [f'<p style="max-width:50em">{escape(text)}</p>' for text in (self.sentence, *self._after)]
        # A dollar in a name is no mathematics.
        return f'<div class="tex2jax_ignore mathjax_ignore">{first}{table}{"".join(after)}</div>'

    @property
    def _right(self) -> list[bool]:
        """The columns with numbers only, which are right-aligned."""
        columns = zip(*self.rows, strict=True)
        return [any(column) and all(_NUMBER.fullmatch(cell) for cell in column) for column in columns]

    @property
    def _after(self) -> list[str]:
        rest = len(self.rows) - MOST
        return [*([f"and {rest} more"] if rest > 0 else []), *self.notes]


class Tabular:
    """An object that is displayed as a table; a dataclass of this kind leaves `__repr__` to it (`repr=False`)."""

    def _table(self) -> Table:
        raise NotImplementedError

    def __repr__(self) -> str:
        return str(self._table())

    def __str__(self) -> str:
        return str(self._table())  # pydantic's models have one of their own

    def _repr_html_(self) -> str:
        return self._table().html()


def cell(value: float | None, look: str = ".3f") -> str:
    """A number as a cell, in a format of Python; a dash without one."""
    return "–" if value is None or not math.isfinite(value) else format(value, look)


def odds(nats: float) -> str:
    """The odds from a log Bayes factor and even prior odds, such as `20 to 1`."""
    # Two digits, and no power of ten.
    return f"{float(f'{math.exp(nats):.2g}'):.7g} to 1" if nats < math.log(1e6) else "more than a million to 1"
