"""How does the cost grow?  `python benchmarks/growth.py`: one figure, `growth.png`, and its numbers, `growth.json`."""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from fresh import alone
from run import machine, one_core

FILE = Path(__file__).with_name("growth.json")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=FILE, metavar="FILE.json", help="the figure goes beside it")
    parser.add_argument("--quick", action="store_true", help="few small sizes: to see that it runs, not to quote")
    parser.add_argument("--draw", action="store_true", help="draw the last numbers again, measure nothing")
    options = parser.parse_args()
    if not options.draw:
        panels = alone(_measured, options.quick, cores=one_core())
        found = {"machine": machine(), "quick": options.quick, "panels": panels}
        options.output.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    draw(json.loads(options.output.read_text(encoding="utf-8")), options.output.with_suffix(".png"))


def _measured(quick: bool) -> list[dict[str, Any]]:
    from scaling import QUICK, Sizes, measure

    return measure(QUICK if quick else Sizes())


def order(points: list[list[float]]) -> float:
    """The power of the size that the cost grows with at the largest sizes: the slope over the last factor of four."""
    sizes, costs = np.log(np.asarray(points, float).T)
    last = sizes >= sizes[-1] - np.log(4.001)
    return float(np.polyfit(sizes[last], costs[last], 1)[0])


def draw(found: dict[str, Any], path: Path) -> None:
    """The figure: a panel for each thing that was made larger, with a dashed line for growth in proportion."""
    from matplotlib.lines import Line2D

    from hsed_jax.reporting import style

    @style.in_house_style
    def save():
        figure, panels = style.panels(len(found["panels"]), 2.2, across=3)
        for axes, panel in zip(panels, found["panels"], strict=True):
            _draw_panel(axes, panel, (style.BLUE, style.RED))
        style.panel_titles(panels)
        for axes, panel in zip(panels, found["panels"], strict=True):
            axes.set_title(f"{axes.get_title(loc='left')} {panel['title']}", loc="left")
        figure.legend([Line2D([], [], **_PROPORTIONAL)], ["in proportion to the size $n$"], loc="outside upper center")
        figure.savefig(path, dpi=150)

    save()


_PROPORTIONAL = {"color": "#808080", "linestyle": (0, (4, 2)), "linewidth": 0.9, "zorder": 1}


def _draw_panel(axes: Any, panel: dict[str, Any], colours: tuple[str, ...]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    plain = FuncFormatter(lambda value, _: f"{value:g}")
    for (name, points), colour, marker in zip(panel["curves"].items(), colours, "os", strict=False):
        sizes, costs = np.asarray(points, float).T
        axes.loglog(sizes, costs[-1] * sizes / sizes[-1], **_PROPORTIONAL)
        axes.loglog(sizes, costs, color=colour, marker=marker, label=f"{name} ∝ $n^{{{order(points):.1f}}}$")
    axes.set(xlabel=panel["size"], ylabel=panel["cost"])
    if sizes[-1] <= 100 * sizes[0] < 1e4:
        axes.set_xticks(sizes)
        axes.xaxis.set_major_formatter(plain)
        axes.xaxis.set_minor_formatter(NullFormatter())
    # The legend stands above the curves, where it covers none of them, and must not push the panels apart.
    bottom, top = axes.get_ylim()
    top *= (top / bottom) ** (0.05 + 0.1 * len(panel["curves"]))
    axes.set_ylim(top=top)
    axes.legend(loc="upper left", fontsize=7, borderaxespad=0.1, handlelength=1.2).set_in_layout(False)
    axes.yaxis.set_minor_formatter(NullFormatter())
    if top < 100 * bottom:
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(plain)


if __name__ == "__main__":
    main()
