"""Excitations other than ground motions: forces on masses, imposed elongations."""

import numpy as np
from jaxtyping import Float
from matplotlib.collections import LineCollection

from hsed_jax.physics import display
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture


@style.in_house_style
def histories(channel: str, times: Float[np.ndarray, "n m"], values: Float[np.ndarray, "n m"], pair: Pair) -> Picture:
    """Fig. 3 of forces or elongations: random realisations in grey, the one at the central inputs in red.

    Arguments:
        channel: the drawn one.
        times: [s], the first row at the central inputs; the duration of an imposed elongation depends on its inputs.
        values: SI.
        pair: that the specimens are measured in.
    """
    divisor, unit = display.shown(pair, channel, values)
    count, scaled = len(values) - 1, values / divisor
    figure = style.new_figure(2.9)
    panel = figure.subplots()
    curves = [np.column_stack(pair) for pair in zip(times[1:], scaled[1:], strict=True)]
    panel.add_collection(
        LineCollection(
            curves, colors=style.DARK_GREY, linewidths=0.5, alpha=max(0.08, 30 / max(count, 30)), rasterized=True
        )
    )
    panel.plot([], [], color=style.GREY, label=f"{count} random realisations")
    panel.plot(times[0], scaled[0], color=style.RED, linewidth=1.8, label="central inputs")
    panel.margins(x=0.0)
    panel.set(xlabel="Time [s]", ylabel=style.channel_label(channel, unit, pair))
    style.legend(figure, panel)
    what = pair.output(channel).meaning
    return Picture(
        figure,
        f"Excitation of the experiments: {what}.  Grey: {count} random realisations of the inputs; red: central inputs.",
        f"One panel of curves. Largest {what}: {np.abs(scaled[0]).max():.4g} {unit} at the central inputs, "
        f"{np.abs(scaled[1:]).max():.4g} {unit} among {count} realisations.",
    )
