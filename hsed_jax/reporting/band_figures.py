"""The figure of a predictive band with its parts: the uncertainty of the parameters, of the model, and the noise."""

import numpy as np

from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.measurements import Campaign
from hsed_jax.physics import display
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture

_90 = 1.6448536  # standard deviations on both sides hold 90 %
_MOST = 40
_SHADES = {"parameters": 0.85, "model": 0.45, "noise": 0.2}


def nested(prediction: Prediction) -> dict[str, np.ndarray]:
    """Half-widths of bands by their outermost part, (n, J): each holds the parts before it, from the innermost outwards."""
    found, total = {}, np.zeros_like(prediction.sd)
    for name in sorted(prediction.parts, key=[*_SHADES].index):
        total = np.hypot(total, prediction.parts[name])
        found[name] = _90 * total
    return found


@style.in_house_style
def band_parts(comparison: Comparison, campaign: Campaign) -> Picture | None:
    """The 90 % bands of experiments with their parts, and the measurements; of held-out experiments, if there are any.

    Arguments:
        comparison: of a calibrated model with an estimate of its error.
        campaign: the experiments.

    Returns:
        Quantities minus the predictions of the model alone, side by side; for histories, those with the largest error.  None
        without a statement on the error of the model.
    """
    split, part, prediction = list(comparison.splits())[-1]
    if "model" not in prediction.parts:
        return None
    if prediction.groups.size == len(prediction.outputs):
        return _of_quantities(split, prediction, campaign.pair)
    errors = part.per_experiment
    known = [row for row, e in enumerate(prediction.experiments) if e.id in errors and not prediction.diverged[row]]
    if not known:
        return None
    row = max(known, key=lambda row: max(values["nrmse"] for values in errors[prediction.experiments[row].id].values()))
    return _of_histories(split, prediction, row, campaign)


def _of_quantities(split: str, prediction: Prediction, pair: Pair) -> Picture:
    names = prediction.outputs
    figure = style.new_figure(1.8 * len(names) + 0.5)
    panels = list(np.ravel(figure.subplots(len(names), 1, sharex=True)))
    bands, said = nested(prediction), []
    for j, (panel, name) in enumerate(zip(panels, names, strict=True)):
        rows = np.flatnonzero(prediction.used[:, j] & np.isfinite(prediction.shown[:, j]))
        rows = rows[np.argsort(prediction.shown[rows, j])]
        rows = rows[np.unique(np.linspace(0, rows.size - 1, min(rows.size, _MOST)).astype(int))]
        at, alone = np.arange(1, rows.size + 1), prediction.shown[rows, j]
        middle, measured = prediction.mean[rows, j] - alone, prediction.measured[rows, j] - alone
        widths = {part: width[rows, j] for part, width in bands.items()}
        divisor, unit = display.shown(pair, name, measured, *(middle + w for w in widths.values()))
        for part, width in reversed(widths.items()):
            panel.bar(at, 2 * width / divisor, 0.8, (middle - width) / divisor, color=style.BLUE, linewidth=0,
                      alpha=_SHADES[part], label=_words(part), zorder=1)  # fmt: skip
        if (plain := prediction.without) is not None:
            edges = (plain.mean[rows, j] - alone)[:, None] + _90 * plain.sd[rows, j][:, None] * np.array([-1, 1])
            panel.hlines(edges.T.ravel() / divisor, np.tile(at - 0.4, 2), np.tile(at + 0.4, 2), color=style.RED,
                         linewidth=1.0, label="90 % band without discrepancy", zorder=3)  # fmt: skip
        panel.plot(at, measured / divisor, "o", ms=3.5, mfc="white", mec=style.BLACK, zorder=4, label="measured")
        panel.axhline(0.0, color=style.BLACK, linewidth=0.8, zorder=2, label="model alone")
        panel.set_ylabel(f"{pair.called(name).capitalize()}\nminus model [{style.unit_text(unit)}]")
        inside = np.abs(measured - middle) <= widths["noise"]
        said.append(f"{pair.called(name)}: {int(inside.sum())} of {rows.size} measurements inside")
    panels[-1].set_xlabel("Experiments, ordered by the prediction")
    figure.align_ylabels(panels)
    style.panel_titles(panels)
    style.legend(figure, panels[0])
    return Picture(
        figure,
        f"90 % predictive bands ({split}) with their parts, minus the prediction of the model alone at the MAP: "
        f"{style.lettered([*map(pair.called, names)])}.  Each shade contains the shades inside it.",
        f"Bars around a line at zero, which is the model alone. {'; '.join(said)}.",
    )


def _of_histories(split: str, prediction: Prediction, row: int, campaign: Campaign) -> Picture:
    experiment, pair, names = prediction.experiments[row], campaign.pair, prediction.outputs
    assert experiment.record is not None
    figure = style.new_figure(2.0 * len(names) + 0.5)
    panels = list(np.ravel(figure.subplots(len(names), 1, sharex=True)))
    bands, time = nested(prediction), experiment.record.time
    for panel, name in zip(panels, names, strict=True):
        _, predicted, mean, _ = prediction.histories(row, name)
        measured = style.recorded(panel, prediction, row, name)
        divisor, unit = display.shown(pair, name, measured, predicted)
        for part, width in reversed(bands.items()):
            half = width[row, prediction.columns(name)][: time.size]
            panel.fill_between(time, (mean - half) / divisor, (mean + half) / divisor, color=style.BLUE, linewidth=0,
                               alpha=_SHADES[part], label=_words(part), zorder=1)  # fmt: skip
        if (plain := prediction.without) is not None:
            own = row, prediction.columns(name)
            edges = (plain.mean[own] + _90 * plain.sd[own] * side for side in (-1, 1))
            for edge, label in zip(edges, ("90 % band without discrepancy", None), strict=True):
                panel.plot(time, edge[: time.size] / divisor, color=style.RED, linewidth=0.7, label=label, zorder=2)
        panel.plot(time, measured / divisor, **{**style.MEASURED, "label": "measured"})
        panel.set_ylabel(style.history_label(name, unit, pair))
        panel.margins(x=0.0)
    panels[-1].set_xlabel("Time [s]" if campaign.has_time else "Row")
    figure.align_ylabels(panels)
    style.panel_titles(panels)
    style.legend(figure, panels[0])
    which = experiment.id.replace("$", "")
    return Picture(
        figure,
        f"90 % predictive band of experiment {which} ({split}) with its parts: {style.lettered([*map(pair.called, names)])}.  "
        "Each shade contains the shades inside it.",
        f"Histories of {', '.join(map(pair.called, names))} as measured, in nested bands.",
    )


def _words(part: str) -> str:
    """The name of a shade in the legend."""
    return part if part == next(iter(_SHADES)) else f"and {part}"
