"""A figure's SVG as part of a page: in the page's colours, its identifiers its own, its caption and alternative text known."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

from hsed_jax.reporting import style

_COLOURS = {style.BLACK: "ink", "#ffffff": "paper", "#e4e4e4": "grid", style.BLUE: "blue", style.RED: "red",
            style.DARK_GREY: "faint", style.GREY: "faint", "#c8c8c8": "pale", "#d0d0d0": "grid"}  # fmt: skip
_DUBLIN_CORE = "{http://purl.org/dc/elements/1.1/}"


@dataclass(frozen=True)
class InlineFigure:
    """A figure ready to stand in a page.

    Attributes:
        name: of its files.
        svg: the element.
        caption, alt: as its `Picture` has them.
    """

    name: str
    svg: str
    caption: str
    alt: str


def inline(name: str, text: str) -> InlineFigure:
    """Make an SVG file, as `style.save` writes it, part of a page.

    Arguments:
        name: of the figure; becomes part of every identifier in it.
        text: content of the file.
    """
    caption, alt = (_about(text, what) for what in ("title", "description"))
    drawing = text[text.index("<svg") :]
    drawing = re.sub(r"<metadata>.*?</metadata>|<title>.*?</title>", "", drawing, flags=re.DOTALL)
    # Style rules of an inline drawing would reach the whole page.
    drawing = drawing.replace('<style type="text/css">*{', f'<style type="text/css">[data-figure="{name}"] *{{')
    drawing = re.sub(r'(\bid="|xlink:href="#|url\(#)', rf"\g<1>{name}-", drawing)
    drawing = re.sub("|".join(map(re.escape, _COLOURS)), lambda match: f"var(--{_COLOURS[match[0]]})", drawing)
    head, rest = drawing.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]*"', "", head)
    return InlineFigure(name, f'{head} data-figure="{name}" aria-hidden="true">{rest}', caption, alt)


def _about(text: str, what: str) -> str:
    """A Dublin Core entry of the drawing's metadata."""
    metadata = re.search(r"<metadata>(.*?)</metadata>", text, flags=re.DOTALL)
    if metadata is None:
        return ""
    entry = ElementTree.fromstring(metadata[1]).find(f".//{_DUBLIN_CORE}{what}")
    return "" if entry is None or entry.text is None else entry.text
