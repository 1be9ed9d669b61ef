"""A Sphinx extension: docstrings are written in Markdown; here they become what Sphinx reads.

Code in backquotes, formulas between dollar signs; the sections (`Arguments:`, `Returns:`, …) are napoleon's work, which comes
after this.
"""

import re
from typing import Any

from sphinx.application import Sphinx

_DISPLAY = re.compile(r"^([ \t]*)(.*?)\$\$(.+?)\$\$[ \t]*", re.DOTALL | re.MULTILINE)
_CODE = re.compile(r"(?<![`:\w])`([^`\n]+)`(?!`)")
_INLINE = re.compile(r"\$([^$\n]+(?:\n[^$\n]+)?)\$")
# Unchanged parts: literals and formulas in their present form, and the lines of a display formula.
_KEPT = re.compile(r"(``[^`]+``|:math:`[^`]+`|\.\. math::\n\n(?:[ \t]+\S.*\n?)+)")


def restructured(text: str) -> str:
    """A docstring in Markdown as reStructuredText."""
    text = _DISPLAY.sub(_display, text)
    parts = _KEPT.split(_CODE.sub(r"``\1``", text))
    for number in range(0, len(parts), 2):
        formulas = _KEPT.split(_INLINE.sub(_inline, parts[number]))
        # A bar would begin a substitution.
        formulas[::2] = [part.replace("|", r"\|") for part in formulas[::2]]
        parts[number] = "".join(formulas)
    return "".join(parts)


def _display(match: re.Match[str]) -> str:
    indent, before, formula = match.groups()
    lines = [f"{indent}   {line.strip()}" for line in formula.strip().splitlines()]
    lead = f"{indent}{before.rstrip()}\n\n" if before.strip() else ""
    return "\n".join([f"{lead}{indent}.. math::", "", *lines, "", ""])


def _inline(match: re.Match[str]) -> str:
    following = match.string[match.end() : match.end() + 1]
    # A role ends at a blank or at punctuation; other characters need an invisible blank.
    return f":math:`{' '.join(match[1].split())}`" + ("\\ " if following.isalnum() else "")


def _process(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    lines[:] = restructured("\n".join(lines)).split("\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Hook in, before napoleon."""
    app.connect("autodoc-process-docstring", _process, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
