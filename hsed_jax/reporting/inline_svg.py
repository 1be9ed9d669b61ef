"""A figure's SVG as part of a page: in the page's colours, its identifiers its own, its caption and alternative text known."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

from hsed_jax.errors import UserError
from hsed_jax.reporting import style

_COLOURS = {style.BLACK: "ink", "#ffffff": "paper", "#e4e4e4": "grid", style.BLUE: "blue", style.RED: "red",
            style.DARK_GREY: "faint", style.GREY: "faint", "#c8c8c8": "pale", "#d0d0d0": "grid"}  # fmt: skip
_SVG = "{http://www.w3.org/2000/svg}"
_DRAWN = [
    _SVG + tag
    for tag in ("svg", "defs", "style", "g", "path", "use", "clipPath", "pattern", "rect", "image", "text", "tspan")
]
ElementTree.register_namespace("", _SVG[1:-1])
ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
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

    Raises:
        UserError: it is no drawing, or more than one: a script in it would run in the browser of who reads the page.
    """
    drawing = _drawing(name, text)
    caption, alt = (_about(text, what) for what in ("title", "description"))
    # Style rules of an inline drawing would reach the whole page.
    drawing = drawing.replace('<style type="text/css">*{', f'<style type="text/css">[data-figure="{name}"] *{{')
    drawing = re.sub(r'(\bid="|xlink:href="#|url\(#)', rf"\g<1>{name}-", drawing)
    drawing = re.sub("|".join(map(re.escape, _COLOURS)), lambda match: f"var(--{_COLOURS[match[0]]})", drawing)
    head, rest = drawing.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]*"', "", head)
    return InlineFigure(name, f'{head} data-figure="{name}" aria-hidden="true">{rest}', caption, alt)


def _drawing(name: str, text: str) -> str:
    """The element without its metadata, written anew, so that nothing is in it but what was looked at."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f"figures/{name}.svg: this is no drawing ({error})") from None
    for about in ("metadata", "title"):
        for element in root.findall(f"{_SVG}{about}"):
            root.remove(element)
    for element in root.iter():
        links = [value for key, value in element.attrib.items() if key.rpartition("}")[2] == "href"]
        leads_out = any(not link.startswith(("#", "data:image/png")) for link in links)
        acts = any(key.startswith("on") for key in element.attrib)
        if element.tag not in _DRAWN or leads_out or acts:
            what = element.tag.rpartition("}")[2]
            raise UserError(f"figures/{name}.svg: it holds more than a drawing ({what}), which a page does not take")
    return ElementTree.tostring(root, encoding="unicode")


def _about(text: str, what: str) -> str:
    """A Dublin Core entry of the drawing's metadata."""
    metadata = re.search(r"<metadata>(.*?)</metadata>", text, flags=re.DOTALL)
    if metadata is None:
        return ""
    entry = ElementTree.fromstring(metadata[1]).find(f".//{_DUBLIN_CORE}{what}")
    return "" if entry is None or entry.text is None else entry.text
