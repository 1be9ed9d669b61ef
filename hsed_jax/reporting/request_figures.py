"""Figure of a request: the expected response of an experiment that is not measured yet, or was measured just now."""

from collections.abc import Mapping

import numpy as np

from hsed_jax.measurements import Record
from hsed_jax.physics import display
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture


@style.in_house_style
def expected_response(
    title: str, time: np.ndarray, channels: Mapping[str, np.ndarray], measured: Record | None, pair: Pair
) -> Picture:
    """Every channel over time with its band, and the measurement.

    Arguments:
        title: which experiment.
        time: [s], shape (n,).
        channels: SI, by name: lower end, median and upper end, (3, n).
        measured: the record, where there is one.
        pair: that the specimen is measured in.
    """
    figure, panels = style.panels(len(channels), 2.0, across=1)
    for panel, (name, (low, middle, high)) in zip(panels, channels.items(), strict=True):
        known = None if measured is None else measured.channels.get(name)
        divisor, unit = display.shown(pair, name, low, high)
        band = {"color": style.PREDICTED["color"], "alpha": 0.2, "linewidth": 0}
        panel.fill_between(time, low / divisor, high / divisor, **band, label="90 % band of the expectation")
        panel.plot(time, middle / divisor, **{**style.PREDICTED, "label": "expected"})
        if measured is not None and known is not None:
            panel.plot(measured.time, known / divisor, **{**style.MEASURED, "label": "measured"})
        panel.set_ylabel(style.channel_label(name, unit, pair))
        panel.margins(x=0.0)
    panels[-1].set_xlabel("Time [s]")
    style.panel_titles(panels)
    style.legend(figure, *panels)
    figure.legends[0].set_title(style.plain(title, 90))
    told = "" if measured is None else ", and measured (dashed)"
    return Picture(
        figure,
        f"{style.plain(title, 90)}: the response that the calibrated model expects, with the 90 % band of its parameters{told}.",
        f"Histories of {', '.join(map(pair.called, channels))}.",
    )
