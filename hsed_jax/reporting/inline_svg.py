"""A figure's SVG as part of a page: with the page's colours, unique identifiers, its caption and alternative text.

A run folder may come from another person. Therefore the page accepts only the output of matplotlib: listed elements,
attributes and properties, whose values refer to nothing outside the drawing.
"""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

from hsed_jax.errors import UserError
from hsed_jax.reporting import style

_COLOURS = {style.BLACK: "ink", "#ffffff": "paper", "#e4e4e4": "grid", style.BLUE: "blue", style.RED: "red",
            style.DARK_GREY: "faint", style.GREY: "faint", "#c8c8c8": "pale", "#d0d0d0": "grid"}  # fmt: skip
_SVG = "{http://www.w3.org/2000/svg}"
_LINK = "{http://www.w3.org/1999/xlink}href"
ElementTree.register_namespace("", _SVG[1:-1])
ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
_DUBLIN_CORE = "{http://purl.org/dc/elements/1.1/}"

_ELEMENTS = {
    _SVG + tag
    for tag in ("svg", "defs", "style", "g", "path", "use", "clipPath", "pattern", "rect", "image", "text", "tspan")
}
_ATTRIBUTES = {
    "id", "style", "d", "x", "y", "width", "height", "transform", "clip-path", "viewBox", "version", "type", "patternUnits",
    _LINK,
}  # fmt: skip
_PROPERTIES = {
    "fill", "fill-opacity", "fill-rule", "stroke", "stroke-width", "stroke-opacity", "stroke-linecap", "stroke-linejoin",
    "stroke-miterlimit", "stroke-dasharray", "stroke-dashoffset", "opacity", "font", "font-family", "font-size", "font-style",
    "font-weight", "font-stretch", "font-variant", "text-anchor", "image-rendering",
}  # fmt: skip
_OWN = re.compile(r"url\(#([\w-]+)\)")
_PLAIN = re.compile(r"[\w\s.,#%'+-]*")  # no parenthesis, colon or slash: no address
_NUMBERS = re.compile(r"[\w\s.,/()+-]*")
_LINKED = re.compile(r"#[\w-]+|data:image/png;base64,[\w+/=\s]+")
_SHEET = "*{stroke-linejoin:round;stroke-linecap:butt}"


@dataclass(frozen=True)
class InlineFigure:
    """A figure for a page.

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
        UserError: it is not a drawing, or contains parts that matplotlib does not write: a script would run in the browser of
            the reader, and an address would reveal that the page is read.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f"figures/{name}.svg: this is not a drawing ({error})") from None
    caption, alt = (root.findtext(f"{_SVG}metadata//{_DUBLIN_CORE}{what}") or "" for what in ("title", "description"))
    for about in ("metadata", "title"):
        for element in root.findall(f"{_SVG}{about}"):
            root.remove(element)
    # The name of a file may hold any character, such as a quote.
    mark = re.sub(r"[^A-Za-z0-9_]", lambda match: f"-{ord(match[0]):x}-", name)
    for element in root.iter():
        _make_own(element, name, mark)
    for size in ("width", "height"):
        root.attrib.pop(size, None)
    root.attrib |= {"data-figure": mark, "aria-hidden": "true"}
    return InlineFigure(name, ElementTree.tostring(root, encoding="unicode"), caption, alt)


def _make_own(element: ElementTree.Element, name: str, mark: str) -> None:
    """Check an element, and give it the page's colours and unique identifiers.

    Raises:
        UserError: matplotlib does not write such an element.
    """
    if element.tag not in _ELEMENTS:
        raise _refused(name, element.tag.rpartition("}")[2])
    if element.tag == f"{_SVG}style":
        if re.sub(r"\s", "", element.text or "") != _SHEET:
            raise _refused(name, "style")
        # Style rules of an inline drawing reach the whole page.
        element.text = f'[data-figure="{mark}"] {_SHEET}'
    for key, value in element.attrib.items():
        if key not in _ATTRIBUTES | _PROPERTIES:
            raise _refused(name, key.rpartition("}")[2])
        element.set(key, _looked_at(key, value, name, mark))


def _looked_at(key: str, value: str, name: str, mark: str) -> str:
    """The checked value of an attribute."""
    if key == "style":
        declared = (one.partition(":") for one in value.split(";") if one.strip())
        return "; ".join(
            f"{about.strip()}: {_set(about.strip(), text.strip(), name, mark)}" for about, _, text in declared
        )
    if key in _PROPERTIES:
        return _set(key, value, name, mark)
    if key == "id" and _PLAIN.fullmatch(value):
        return f"{mark}-{value}"
    if key == _LINK and _LINKED.fullmatch(value):
        return f"#{mark}-{value[1:]}" if value.startswith("#") else value
    if own := _OWN.fullmatch(value):
        return f"url(#{mark}-{own[1]})"
    if key in ("id", _LINK) or not _NUMBERS.fullmatch(value):
        raise _refused(name, key.rpartition("}")[2])
    return value


def _set(about: str, value: str, name: str, mark: str) -> str:
    """The checked value of a property."""
    if about not in _PROPERTIES:
        raise _refused(name, about)
    if own := _OWN.fullmatch(value):
        return f"url(#{mark}-{own[1]})"
    if not _PLAIN.fullmatch(value):
        raise _refused(name, about)
    return f"var(--{_COLOURS[value]})" if value in _COLOURS else value


def _refused(name: str, what: str) -> UserError:
    return UserError(f"figures/{name}.svg: it contains more than a drawing ({what}), which a page does not accept")
