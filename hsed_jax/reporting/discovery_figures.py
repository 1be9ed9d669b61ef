"""The figure of a discovery: the learned function over its variables, with its band and its formula."""

import numpy as np

from hsed_jax.discovery.findings import Discovery
from hsed_jax.measurements import Campaign
from hsed_jax.physics import display
from hsed_jax.physics.effects.coordinates import COORDINATES
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture

_DASHES = (0, (4, 1.6))
_COLOURS = (style.RED, style.BLACK, style.BLUE)


@style.in_house_style
def learned(discovery: Discovery, campaign: Campaign) -> Picture:
    """The learned function: its curve with the 90 % band, and its formula.

    Arguments:
        discovery: one that found something.
        campaign: whose pair names elongation and force.
    """
    assert discovery.place is not None
    place, lines, pair = discovery.place, discovery.lines(), campaign.pair
    first, *rest = place.of
    across, unit = display.shown_in(pair, COORDINATES[first].unit, *(line.x for line in lines))
    is_force = place.slot == "force"
    height, of_height = display.shown(pair, "force", *(line.high for line in lines)) if is_force else (1.0, "")
    figure = style.new_figure(3.2)
    panel = figure.subplots()
    for line, colour in zip(lines, _COLOURS if len(lines) > 1 else (style.BLUE,), strict=False):
        label = "" if line.at is None else f" at {_at(rest[0], line.at, pair)}"
        panel.fill_between(
            line.x / across, line.low / height, line.high / height, color=colour, alpha=0.18, linewidth=0
        )
        panel.plot(line.x / across, line.mean / height, color=colour, linewidth=2.6, alpha=0.5, label=f"curve{label}")
        if line.formula is not None:
            panel.plot(line.x / across, line.formula / height, color=colour, linestyle=_DASHES, linewidth=1.2,
                       label=f"formula{label}")  # fmt: skip
    panel.axhline(0.0 if is_force else 1.0, color=style.GREY, linewidth=0.8, zorder=0)
    words = COORDINATES[first].words.removeprefix("the ")
    title = pair.words(words)
    panel.set_xlabel(f"{title[0].upper()}{title[1:]} [{style.unit_text(unit)}]")
    panel.set_ylabel(
        f"Learned {pair.words('force')} [{style.unit_text(of_height)}]" if is_force else "Learned factor [–]"
    )
    style.legend(figure, panel)
    found = f"{pair.words(place.words)}: {discovery.formula}"
    return Picture(
        figure,
        f"Learned effect: {found}.  The curve is that of a Gaussian process, the formula was fitted inside the simulation.  "
        "The 90 % band includes the part that the parameters of the law could replace.",
        f"A curve with a band over {words}. {found}.",
    )


def _at(name: str, value: float, pair: Pair) -> str:
    """A value of the second coordinate."""
    if name == "direction":
        return "opening" if value > 0 else "closing"
    divisor, unit = display.shown_in(pair, COORDINATES[name].unit, np.asarray([value]))
    return f"{COORDINATES[name].words.removeprefix('the ')} {value / divisor:.3g} {unit}".strip()
