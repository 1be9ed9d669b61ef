"""Are two texts the same up to rounding?  The words are equal, and the numbers are, to a twentieth."""

import math
import re

_NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+\.?\d*(?:e[-+]?\d+)?")


def difference(printed: str, shown: str, relative: float = 0.05, absolute: float = 0.002) -> str | None:
    """The first difference of what was printed from what is shown, or None."""
    texts = [re.sub(r"[ \-─]{2,}", " ", text) for text in (printed, shown)]
    words = [_NUMBER.sub("#", text).split() for text in texts]
    for ours, theirs in zip(*words, strict=False):
        if ours != theirs:
            return f"{ours!r} was printed, {theirs!r} is shown"
    if len(words[0]) != len(words[1]):
        return f"{len(words[0])} words were printed, {len(words[1])} are shown"
    numbers = [[float(one.replace("−", "-")) for one in _NUMBER.findall(text)] for text in texts]
    for ours, theirs in zip(*numbers, strict=True):
        if not math.isclose(ours, theirs, rel_tol=relative, abs_tol=absolute):
            return f"{ours:g} was printed, {theirs:g} is shown"
    return None
