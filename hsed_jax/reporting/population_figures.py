"""The figure of a population: the parameters that vary between specimens, of each specimen and of an untested one."""

from collections.abc import Mapping
from typing import Any

from hsed_jax.physics import display
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture


@style.in_house_style
def population(level: str, parameters: Mapping[str, Mapping[str, Any]], units: Mapping[str, str]) -> Picture:
    """A panel for each parameter that varies with a level: every member with its 90 % interval, and the population behind them.

    Arguments:
        level: the column that distinguishes the specimens.
        parameters: the varying ones, as `Fit.levels` has it for a level.
        units: SI units by name.
    """
    names = list(parameters)
    members = list(parameters[names[0]]["of"])
    figure = style.new_figure(min(1.3 + 0.22 * len(members), 8.0))
    grid = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    places = range(len(members), 0, -1)
    for panel, name in zip(grid, names, strict=True):
        told = parameters[name]
        of, center, untested = list(told["of"].values()), told["mean"], told["untested"]
        numbers = [v[key] for v in (*of, center, untested) for key in ("q05", "q95")]
        scale, unit = display.readable(units.get(name, "1"), numbers)
        panel.axvspan(untested["q05"] / scale, untested["q95"] / scale, color=style.GREY, alpha=0.3, linewidth=0,
                      label=f"a {level} that was not tested, 90 %")  # fmt: skip
        panel.axvline(center["mean"] / scale, color=style.DARK_GREY, linewidth=1.0, label="centre of the population")
        panel.errorbar(
            [v["mean"] / scale for v in of],
            places,
            xerr=[
                [(v["mean"] - v["q05"]) / scale for v in of],
                [(v["q95"] - v["mean"]) / scale for v in of],
            ],
            fmt="o",
            color=style.BLUE,
            elinewidth=1.1,
            label=f"each {level}, mean and 90 %",
        )
        panel.set_xlabel(style.label(name, unit))
        panel.locator_params(axis="x", nbins=4)
    grid[0].set_yticks(list(places), members)
    grid[0].set_ylabel(level)
    style.legend(figure, grid[0])
    said = "; ".join(
        f"{name} {told['mean']['mean']:.4g} with a spread of {told['spread']['mean']:.2g}"
        for name, told in parameters.items()
    )
    return Picture(
        figure,
        f"Parameters that vary between the {len(members)} members of {level}: mean and 90 % interval of each, beside those of "
        "the population.",
        f"A panel for each of {', '.join(names)}: {said}.",
    )
