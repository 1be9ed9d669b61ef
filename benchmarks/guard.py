"""Has anything become slower or less accurate?  What was measured now against what is kept, by ratios and never by seconds.

A ratio to a peer carries over from machine to machine and from a busy hour to a quiet one; seconds do not.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

FACTOR = 1.3
"""A ratio that grew by more than this, and does so when it is measured again, has grown."""

ERROR_FACTOR = 3.0
"""An error of ours that grew by more than this has grown: another order of summation does not do that."""

ERRORS = {
    "peaks": 1e-6,
    "energy": 1e-6,
    "against differences": 1e-5,
    "log-likelihood below the best": 1e-4,
    "difference from the loop": 1e-9,
    "mean from NUTS [sd]": 0.1,
    "effect not named": 0.3,
}
"""The figures of accuracy that are errors, each with the size up to which it is rounding or chance.  Others are not compared:
effective samples, say, are better the more there are."""

Lines = Sequence[dict[str, Any]]


class Grown(NamedTuple):
    """A ratio or an error that grew: where, and a sentence."""

    row: str
    work: str
    what: str
    sentence: str


def guarded(kept: Lines, measure: Callable[[Sequence[str]], Lines], rows: Sequence[str]) -> tuple[list[str], list[str]]:
    """What grew, and what could not be compared, one sentence each.

    Arguments:
        kept: lines of earlier results.
        measure: measures rows.
        rows: which rows to measure; those in which something grew are measured twice, since a busy machine now and then
            disturbs us or, worse, does not disturb the peer.
    """
    now = measure(rows)
    if not {_place(entry) for entry in kept} & {_place(entry) for entry in now}:
        return ["nothing was compared: no line is both kept and measured now"], uncompared(kept, now, rows)
    found = grown(kept, now)
    doubted = [row for row in rows if any(row == one.row for one in found)]
    again = {one[:3]: one for one in grown(kept, measure(doubted))} if doubted else {}
    return [again[one[:3]].sentence for one in found if one[:3] in again], uncompared(kept, now, rows)


def grown(kept: Lines, now: Lines) -> list[Grown]:
    """The ratios and errors that grew, of lines that are both kept and measured now."""
    before = {_place(entry): entry for entry in kept}
    pairs = [(before[_place(entry)], entry) for entry in now if _place(entry) in before]
    return [found for pair in pairs for found in (*_slower(*pair), *_less_accurate(*pair))]


def uncompared(kept: Lines, now: Lines, rows: Sequence[str]) -> list[str]:
    """Lines of these rows, and peers and errors of lines, that are only kept or only measured now."""
    before = {_place(entry): entry for entry in kept if entry["row"] in rows}
    after = {_place(entry): entry for entry in now}
    found = []
    for ones, others, what in (
        (after, before, "measured now, but not kept"),
        (before, after, "kept, but not measured now"),
    ):
        for place, entry in ones.items():
            if place not in others:
                found.append(f"{', '.join(place)}: {what}")
                continue
            names = [name for name in _guarded_names(entry) if name not in _guarded_names(others[place])]
            found += [f"{', '.join(place)}: {name} is {what}" for name in names]
    return found


def _slower(kept: dict[str, Any], now: dict[str, Any]) -> Iterable[Grown]:
    for peer, ratio in now["ratios"].items():
        earlier = kept["ratios"].get(peer)
        # A ratio that is no number compares as false, and has grown.
        if earlier is None or ratio <= FACTOR * earlier:
            continue
        # With both costs one sees whether we became slower, or the peer faster.
        ours = f"ours {kept['ours']:.3g} → {now['ours']:.3g}"
        theirs = f"{peer} {kept['peers'][peer]:.3g} → {now['peers'][peer]:.3g}"
        yield Grown(
            *_place(now),
            f"ratio to {peer}",
            f"{', '.join(_place(now))}: {ratio / earlier:.2f} times the kept ratio to {peer}, {earlier:.3g} → {ratio:.3g}; "
            f"at most {FACTOR} times is allowed ({ours} and {theirs} {now['unit']})",
        )


def _less_accurate(kept: dict[str, Any], now: dict[str, Any]) -> Iterable[Grown]:
    before = _errors(kept)
    for name, error in _errors(now).items():
        if name in before and not error <= ERROR_FACTOR * max(before[name], ERRORS[name]):
            yield Grown(
                *_place(now),
                f"error of {name}",
                f"{', '.join(_place(now))}: the error of {name!r} grew from {before[name]:.3g} to {error:.3g}; at most "
                f"{ERROR_FACTOR:g} times is allowed",
            )


def _place(entry: dict[str, Any]) -> tuple[str, str]:
    return entry["row"], entry["work"]


def _errors(entry: dict[str, Any]) -> dict[str, float]:
    return {name: value for name, value in entry["accuracy"].get("ours", {}).items() if name in ERRORS}


def _guarded_names(entry: dict[str, Any]) -> list[str]:
    return [
        *(f"the ratio to {peer}" for peer in entry["ratios"]),
        *(f"the error of {name!r}" for name in _errors(entry)),
    ]
