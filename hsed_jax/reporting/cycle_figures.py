"""Engineering measures of a loop, measured against predicted: energy and stiffness of each cycle, and the backbone."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from hsed_jax.criticism.compare import Comparison
from hsed_jax.measurements import Campaign, backbone_of, cycles_of
from hsed_jax.physics import display
from hsed_jax.physics.names import named
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import style
from hsed_jax.reporting.misfit_figures import badness, hysteresis_loops
from hsed_jax.reporting.style import Picture

_MOST = 3
_LOOKS: dict[str, dict[str, Any]] = {
    "measured": {**style.MEASURED, "marker": "s", "mfc": "white", "label": "measured"},
    "predicted": {**style.PREDICTED, "marker": "o", "label": "predicted"},
    "as it was": {"color": style.RED, "linestyle": (0, (6, 1.2, 1, 1.2)), "linewidth": 0.9, "marker": "v",
                  "label": "model as it was", "zorder": 2},
    "improved": {**style.PREDICTED, "marker": "o", "label": "improved model"},
}  # fmt: skip


class Cycles(NamedTuple):
    """Measures of one loop: energy and stiffness of each cycle, elongation and force of the backbone (SI)."""

    energy: np.ndarray
    stiffness: np.ndarray
    elongation: np.ndarray
    force: np.ndarray


@style.in_house_style
def cycles(comparison: Comparison, campaign: Campaign, before: Comparison | None = None) -> Picture | None:
    """A row per experiment: energy per cycle, secant stiffness per cycle and backbone, measured and predicted.

    Arguments:
        comparison: of histories; the held-out experiments come first, and of each split those with the largest errors of the
            force; of more than three the first three are shown.
        campaign: whether the elongation was imposed.
        before: of the first model, drawn beneath.

    Returns:
        The picture; None where force and elongation are not both known.
    """
    models = {"predicted": comparison} if before is None else {"as it was": before, "improved": comparison}
    found = _experiments(next(iter(models.values())), campaign)
    if not found:
        return None
    shown = found[:_MOST]
    figure, panels = style.panels(3 * len(shown), 2.2, across=3)
    pair, said = campaign.pair, []
    stiffness = pair.unit("N/m")
    for number, (split, id, owner) in enumerate(shown):
        row = panels[3 * number : 3 * number + 3]
        read = _read(models, split, id, owner, campaign)
        _draw(row, read, pair)
        # Short enough beside the letter of the panel.
        name = style.plain(id, 10 if owner else 16)
        row[0].set_title(f"{name} ({split})" + (f", {style.plain(owner, 8)}" if owner else ""), loc="right")
        measured, ours = read["measured"], list(read.values())[-1]
        said.append(
            f"{id}: {measured.energy.size} cycles, energy {_of(measured.energy.sum(), pair.energy_unit)} measured, "
            f"{_of(ours.energy.sum(), pair.energy_unit)} predicted; stiffness of the last "
            f"{_of(measured.stiffness[-1], stiffness)} measured, {_of(ours.stiffness[-1], stiffness)} predicted"
        )
    style.panel_titles(panels)
    style.legend(figure, panels[0])
    rest = len(found) - len(shown)
    return Picture(
        figure,
        "Absorbed energy of each cycle (left), its secant stiffness from peak to peak (middle), and the backbone through the "
        f"peaks that exceed all earlier ones (right), measured and predicted, over the cycles of the measured {pair.elongation}; "
        "one row per experiment.  "
        "The stiffness of a cycle that hardly exceeds the noise is as uncertain as its peaks."
        + (f"  {rest} more are not shown." if rest else ""),
        f"{3 * len(shown)} panels of curves. {'. '.join(said).replace('$', '')}.",
    )


def _experiments(comparison: Comparison, campaign: Campaign) -> list[tuple[str, str, str]]:
    """Split, id and specimen of every loop of an experiment, held-out ones first, the largest errors of the force first."""
    found = []
    for name, split, prediction in comparison.splits():
        for row, experiment in enumerate(prediction.experiments):
            errors = split.per_experiment.get(experiment.id, {})
            for owner, loop in hysteresis_loops(prediction, row, campaign).items():
                there, force = loop[0][np.isfinite(loop[0] + loop[1])], named(owner, "force")
                if force in errors and there.size > 2 and np.ptp(there) > 0:
                    found.append((name != "test", -badness(errors[force]), name, experiment.id, owner))
    return [(name, id, owner) for *_, name, id, owner in sorted(found)]


def _read(models: Mapping[str, Comparison], split: str, id: str, owner: str, campaign: Campaign) -> dict[str, Cycles]:
    """The measured cycles of one experiment and those of each model; diverged ones are left out."""
    read = {}
    for model, comparison in models.items():
        prediction = next(p for name, _, p in comparison.splits() if name == split)
        row = [e.id for e in prediction.experiments].index(id)
        loop = hysteresis_loops(prediction, row, campaign)[owner]
        there, force, ours, predicted = (channel[np.isfinite(loop[0] + loop[1])] for channel in loop)
        read.setdefault("measured", _cycles(force, there, there))
        read[model] = _cycles(predicted, ours, there)
    return read


def _cycles(force: np.ndarray, elongation: np.ndarray, along: np.ndarray) -> Cycles:
    if not np.isfinite(force + elongation).all():
        nothing = np.full(len(cycles_of(along, along)), np.nan)
        return Cycles(nothing, nothing, np.zeros(0), np.zeros(0))
    found = cycles_of(force, elongation, along)
    backbone = backbone_of(force, elongation, found)
    return Cycles(found.energy, found.secant_stiffness, backbone.elongation, backbone.force)


def _draw(row: list[Axes], read: Mapping[str, Cycles], pair: Pair) -> None:
    scales = {
        name: display.shown_in(pair, unit, *(getattr(one, name) for one in read.values()))
        for name, unit in (("energy", "J"), ("stiffness", "N/m"), ("elongation", "m"), ("force", "N"))
    }
    for who, one in read.items():
        energy, stiffness, elongation, force = (getattr(one, name) / scales[name][0] for name in Cycles._fields)
        count = np.arange(1, energy.size + 1)
        for panel, x, y in zip(row, (count, count, elongation), (energy, stiffness, force), strict=True):
            panel.plot(x, y, **_LOOKS[who])
    for panel, (word, name) in zip(row, (("Energy", "energy"), ("Secant stiffness", "stiffness")), strict=False):
        panel.set(xlabel="Cycle", ylabel=f"{word} [{style.unit_text(scales[name][1])}]")
        style.whole_numbers(panel.xaxis)
        panel.update_datalim([(1.0, 0.0)])  # from zero, with room above the highest marker
        panel.autoscale_view()
    labels = [style.channel_label(name, scales[name][1], pair) for name in ("elongation", "force")]
    row[2].set(xlabel=labels[0], ylabel=labels[1])


def _of(value: float, unit: str) -> str:
    divisor, unit = display.readable(unit, np.asarray([value]))
    return style.amount(value / divisor, unit)
