"""The behaviour of a specimen along the test, by numerical experiments on the fitted model: before and after."""

import numpy as np
from matplotlib.axes import Axes

from hsed_jax.behaviour.findings import QUANTITIES, Behaviours, ProbedCurve, in_side
from hsed_jax.physics import display
from hsed_jax.physics.names import own_name
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture

_COLUMNS = 3
_MOST = 6
# A quantity is shown if it differs by this share of its size, along the test or from the first model.
_DIFFERS = 0.05


@style.in_house_style
def behaviour(found: Behaviours) -> Picture | None:
    """Probed quantities over the path of the longest test, with 90 % bands; None if nothing changes.

    Arguments:
        found: by the diagnosis.
    """
    changed = [one.quantity for one in found.changes]
    ranked = sorted(found.curves, key=lambda name: _order(name, changed))
    shown = [name for name in ranked if _differs(found.curves[name])][:_MOST]
    if not shown or not found.changes:
        return None
    rows = -(-len(shown) // _COLUMNS)
    figure = style.new_figure(1.9 * rows + 0.3)
    panels = figure.subplots(rows, min(_COLUMNS, len(shown)), squeeze=False, sharex=True)
    for panel, name in zip(panels.flat, shown, strict=False):
        _curve(panel, name, found.curves[name], np.asarray(found.places), found.pair)
    for panel in panels.flat[len(shown) :]:
        panel.set_axis_off()
    for panel in panels[-1]:
        panel.set_xlabel("share of the path of the test")
    style.legend(figure, panels.flat[0])
    caption = (
        "Behaviour of the specimen along the path of the longest test, from the same loop in numerical experiments on the "
        "fitted models: the model as it was, dashed, and with the named effects, with a band of 90 % over its posterior."
    )
    said = "; ".join(one.sentence for one in found.changes)
    return Picture(figure, caption, f"{len(shown)} curves. {said}.")


def _curve(panel: Axes, name: str, curve: ProbedCurve, places: np.ndarray, pair: Pair) -> None:
    quantity = own_name(name).rstrip("+-")
    words, si = QUANTITIES[quantity]
    divisor, unit = display.shown_in(pair, si, *curve) if si != "1" else (1.0, "")
    panel.plot(
        places, curve.before / divisor, color=style.RED, linestyle=(0, (6, 1.2, 1, 1.2)), label="model as it was"
    )
    panel.plot(places, curve.mean / divisor, color=style.BLUE, label="with the named effects")
    panel.fill_between(
        places, curve.q05 / divisor, curve.q95 / divisor, color=style.BLUE, alpha=0.25, linewidth=0, label="90 %"
    )
    owner = f"{name.rpartition('.')[0]}: " if "." in name else ""
    panel.set_title(f"{owner}{words}{in_side(name)}", fontsize="small")
    panel.set_ylabel(f"[{unit}]" if unit else "[–]")
    low, high = panel.get_ylim()
    if low > 0:
        panel.set_ylim(0, high)


def _differs(curve: ProbedCurve) -> bool:
    values = np.concatenate([curve.mean, curve.before])
    return bool(np.isfinite(values).all() and np.ptp(values) > _DIFFERS * np.abs(values).max())


def _order(name: str, changed: list[str]) -> tuple[int, int]:
    """Changes first, in their order, then the others in that of the quantities."""
    quantity = own_name(name).rstrip("+-")
    first = changed.index(quantity) if quantity in changed else len(changed)
    return first, [*QUANTITIES].index(quantity)
