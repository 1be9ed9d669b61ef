"""The interactive charts of a report: each function draws one with Altair and returns it as Vega-Lite.

Data stay outside: a chart names its table (`page_tables`) and the page inserts it.  Colours are CSS variables of the page, so
light, dark and print need no second chart.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from operator import or_
from typing import Any

import altair as alt
from altair import theme

from hsed_jax.reporting.page_tables import SERIES, Axis

Specification = dict[str, Any]

INK, FAINT, GRID, BLUE, RED, GREEN = (f"var(--{name})" for name in ("ink", "faint", "grid", "blue", "red", "good"))

_COLOURS = {"measured": INK, "as it was": RED, "improved": BLUE, "with the remainder": GREEN, "noise": FAINT}
_DASHES = {"measured": [1, 0], "as it was": [7, 3], "improved": [1, 0], "with the remainder": [2, 2]}
_ZOOM = "wheel![event.shiftKey]"  # the wheel alone moves the page
_WIDTH = 880
_TITLES: Any = {"labelColor": INK, "titleColor": INK, "titleFontWeight": "normal"}
_CONFIG = alt.Config(
    font="system-ui, sans-serif",
    view=alt.ViewConfig(stroke=None),
    axis=alt.AxisConfig(**_TITLES, gridColor=GRID, domainColor=FAINT, tickColor=FAINT, labelFontSize=11, titleFontSize=12),
    legend=alt.LegendConfig(**_TITLES, labelFontSize=12, orient="top"),
    title=alt.TitleConfig(color=INK, fontWeight="normal", fontSize=13, anchor="start"),
    header=alt.HeaderConfig(labelColor=INK, titleColor=INK, labelFontSize=12),
)  # fmt: skip
_FREE = alt.Scale(zero=False)
_CHOSEN = alt.param(name="experiment", value="")
_IS_CHOSEN = alt.datum.experiment == _CHOSEN


def errors_over_inputs(inputs: Sequence[tuple[str, str]], largest: float, models: Sequence[str]) -> Specification:
    """The error of every experiment: on a map of two inputs, or against each of one or more, or side by side.

    Arguments:
        inputs: name and unit of the inputs that vary.
        largest: error of any model; all are drawn on its scale.
        models: keys of `FinishedRun.comparisons`.
    """
    titles = {name: f"{name} [{unit}]" for name, unit in inputs}
    look: Any = {"filled": True, "stroke": INK, "opacity": 1, "cursor": "pointer"}
    said: Any = {
        "tooltip": _tooltip(["experiment", "split"], [*titles, "error"]),
        "shape": _split(),
        "strokeWidth": alt.when(_IS_CHOSEN).then(alt.value(3)).otherwise(alt.value(0.8)),
    }
    if len(inputs) == 2:
        right, apart = alt.Legend(orient="right"), alt.Scale(zero=False, padding=16)
        x, y = (of(name, title=title, scale=apart) for of, (name, title) in zip((_x, _y), titles.items(), strict=True))
        shades = alt.Scale(scheme="yelloworangered", domain=[0, largest])
        sizes = alt.Scale(range=[60, 500], domain=[0, largest])
        error = [_number(of, "error", scale=s, legend=right) for of, s in ((alt.Color, shades), (alt.Size, sizes))]
        drawn = alt.Chart(width=0.6 * _WIDTH, height=320).mark_point(**look).encode(x, y, *error, **said)
    else:
        against = [_x(name, title=title, scale=_FREE) for name, title in titles.items()]
        y = _y("error", scale=alt.Scale(domain=[0, largest]))
        points = alt.Chart(height=230).mark_point(**look, size=90, fill=BLUE).encode(y, **said)
        each = against or [_word(alt.X, "experiment", axis=alt.Axis(labelAngle=0))]
        drawn = _side_by_side([points.encode(x) for x in each], across=3)
    names = [SERIES[model] for model in models]
    model = alt.param(name="model", value=names[0], bind=alt.binding_select(options=names, name="Model"))
    drawn = drawn.transform_calculate(series=_named("model")).transform_filter(alt.datum.series == model)
    return _chart("experiments", "Error of every experiment", drawn, model, _CHOSEN)


def residual_along(
    coordinates: Sequence[str], outputs: Sequence[str], noise: Mapping[str, float], models: Sequence[str]
) -> Specification:
    """The size of the residual over a coordinate that the reader chooses, with the noise as a dotted line.

    Arguments:
        coordinates, outputs: as the table `residual` names them.
        noise: over the RMS of the output, by output.
        models: keys of `FinishedRun.comparisons`.
    """
    along = alt.param(
        name="along", value=coordinates[0], bind=alt.binding_select(options=list(coordinates), name="Along")
    )
    y, color = _y("residual", title="RMS residual / RMS measured"), _color([SERIES[model] for model in models])
    x = _x("from", title=None, scale=alt.Scale(zero=False, nice=False))
    bars = alt.Chart().mark_rule(strokeWidth=2.5).encode(x, alt.X2("to"), y, color)
    middles = alt.Chart().mark_point(size=30, filled=True, opacity=1)
    middles = middles.encode(_x("at"), y, color, tooltip=_tooltip(["series"], ["from", "to", "residual"]))
    panels = []
    for name in outputs:
        layers = [bars, middles]
        if name in noise:
            layers.append(alt.Chart().mark_rule(color=INK, strokeDash=[2, 3]).encode(y=alt.YDatum(noise[name])))
        chosen = (alt.datum.coordinate == along) & (alt.datum.output == name)
        panels.append(alt.layer(*layers, height=220, title=name).transform_filter(chosen))
    drawn = _side_by_side(panels, across=2).transform_calculate(series=_named("model"))
    return _chart("residual", "RMS residual along a coordinate", drawn, along)


def histories(
    axes: Mapping[str, Axis],
    outputs: Sequence[str],
    models: Sequence[str],
    time: str,
    loops: Sequence[str],
    windows: bool,
) -> Specification:
    """Measured against predicted of the experiment that the page chooses: hysteresis loop, and every output over time.

    Arguments:
        axes: how each output is drawn.
        outputs: those over time.
        models: keys of `FinishedRun.comparisons`.
        time: title of the time axis.
        loops: specimens with known force and elongation, by the prefix of their outputs.
        windows: whether only a part of some experiments is scored; this part is shaded.
    """
    show = {
        key: alt.param(name=f"show_{key}", value=True, bind=alt.binding_checkbox(name=SERIES[key]))
        for key in ("measured", *models)
    }
    width, height = (0.5 if loops else 0.88) * _WIDTH, max(150, 330 // len(outputs))
    over_time = [
        alt.layer(
            *([_window()] if windows else []),
            *_history(axes[name].label, name, time, show, index, name == outputs[-1]),
            width=width,
            height=height,
        )
        for index, name in enumerate(outputs)
    ]
    # One zoom of the time axis for all outputs.
    linked = alt.TopLevelSelectionParameter(
        name="zoom",
        select=alt.IntervalSelectionConfig(type="interval", encodings=["x"], zoom=_ZOOM),
        bind="scales",
        views=[f"samples_{index}" for index in range(len(outputs))],
    )
    drawn = alt.vconcat(*over_time)
    if loops:
        tall = ((height + 40) * len(outputs)) / len(loops) - 40
        of_loops = [_loop(axes, owner, show, number, tall) for number, owner in enumerate(loops)]
        drawn = alt.hconcat(*of_loops if len(loops) == 1 else [alt.vconcat(*of_loops)], drawn)
    drawn = drawn.transform_filter(_IS_CHOSEN)
    told = "Measured and predicted response of the chosen experiment"
    return _chart("samples", told, drawn, linked, *show.values(), _CHOSEN)


def _history(
    title: str, name: str, time: str, show: Mapping[str, alt.Parameter], index: int, last: bool
) -> list[alt.Chart]:
    """Layers of one output over time: bands, lines, and the values under the pointer."""
    x = _x("time", title=time if last else None, scale=alt.Scale(nice=False))
    bands = [
        alt.Chart()
        .mark_area(color=_COLOURS[SERIES[key]], opacity=0.18, clip=True)
        .encode(x, _y(f"{name}_{key}_low", title=title), alt.Y2(f"{name}_{key}_high"))
        .transform_filter(show[key])
        for key in list(show)[1:]
    ]
    lines = _folded(alt.Chart(), name, show).mark_line(strokeWidth=1.4, clip=True)
    lines = lines.encode(x, _y("value", title=title), *_look(show))
    under = alt.selection_point(
        name=f"under_{index}", nearest=True, on="pointerover", clear="pointerout", encodings=["x"]
    )
    values = [_number(alt.Tooltip, f"{name}_{key}", title=SERIES[key], format=".4g") for key in show]
    # Invisible, one per sample, for the nearest one to the pointer.  A selection takes every layer with a name, so only this
    # has one.
    spots = alt.Chart(name=f"samples_{index}").mark_point(opacity=0, clip=True).add_params(under)
    spots = spots.encode(
        x, _y(f"{name}_measured", title=title), tooltip=[_number(alt.Tooltip, "time", title=time), *values]
    )
    seen = alt.when(under, empty=False).then(alt.value(1)).otherwise(alt.value(0))
    rule = alt.Chart().mark_rule(color=FAINT, clip=True).encode(x, opacity=seen)
    return [*bands, lines, rule, spots]


def _loop(
    axes: Mapping[str, Axis], owner: str, show: Mapping[str, alt.Parameter], number: int, height: float
) -> alt.Chart:
    """Force over elongation of one specimen; an imposed elongation is the same for all models."""
    along, force = f"{owner}elongation", f"{owner}force"
    imposed = f"datum['{along}_' + datum.key]"
    elongation = f"isValid({imposed}) ? {imposed} : datum['{along}_measured']"
    pan = alt.selection_interval(name=f"pan_{number}", zoom=_ZOOM, bind="scales")
    x, y = _x("elongation", title=axes[along].label), _y("value", title=axes[force].label)
    chart = _folded(alt.Chart(name=f"loop_{number}", width=0.36 * _WIDTH, height=height), force, show)
    chart = chart.transform_calculate(elongation=elongation).add_params(pan)
    return chart.mark_line(strokeWidth=1.1, clip=True).encode(x, y, *_look(show))


def _window() -> alt.Chart:
    """The part of the record that is scored."""
    shaded = alt.Chart(alt.NamedData(name="windows")).mark_rect(color=FAINT, opacity=0.15, clip=True)
    return shaded.encode(alt.X("from", type="quantitative"), alt.X2("to")).transform_filter(_IS_CHOSEN)


def quantities(axes: Mapping[str, Axis], names: Sequence[str], models: Sequence[str]) -> Specification:
    """Predicted against measured quantities with 90 % bands; the chosen experiment is highlighted."""
    color, panels = _color([SERIES[model] for model in models]), []
    said: Any = {
        "tooltip": _tooltip(["experiment", "split", "series"], ["measured", "predicted"]),
        "shape": _split(),
        "size": alt.when(_IS_CHOSEN).then(alt.value(240)).otherwise(alt.value(45)),
    }
    for name in names:
        words, _, unit = axes[name]
        x = _x("measured", title=f"{words}, measured [{unit}]", scale=_FREE)
        y = _y("predicted", title=f"predicted [{unit}]", scale=_FREE)
        equal = alt.Chart().mark_line(color=FAINT, strokeWidth=1).encode(x, _y("measured"))
        bands = alt.Chart().mark_rule(opacity=0.45).encode(x, _y("low"), alt.Y2("high"), color)
        points = alt.Chart().mark_point(filled=True, opacity=1).encode(x, y, color, **said)
        panels.append(alt.layer(equal, bands, points, height=230).transform_filter(alt.datum.quantity == name))
    drawn = _side_by_side(panels, across=3).transform_calculate(series=_named("model"))
    return _chart("quantities", "Predicted against measured quantities", drawn, _CHOSEN)


def errors_by_run() -> Specification:
    """The normalised error of every run, before and after, on fitted and held-out experiments."""
    above = alt.Header(labelAngle=0, labelAlign="left", labelOrient="top")
    drawn = (
        alt.Chart(width=0.7 * _WIDTH, height=alt.Step(12))
        .mark_bar(height=10)
        .encode(
            _x("error", title="normalised error"),
            _word(alt.Y, "split", title=None, sort=["train", "test", "noise"]),
            alt.YOffset("series:N"),
            _color(["as it was", "improved", "noise"]),
            _word(alt.Row, "run", title=None, header=above),
            tooltip=_tooltip(["run", "split", "series"], ["error"]),
        )
    )
    return _chart("errors", "Normalised error of the runs", drawn)


def intervals(names: Sequence[str]) -> Specification:
    """Posterior means and 90 % intervals: a panel per parameter, a row per run and model."""
    y = _word(alt.Y, "run", title=None), alt.YOffset("series:N"), _color(["as it was", "improved"])
    tooltip = _tooltip(["run", "series"], ["mean", "low", "high"])
    low = _x("low", title=None, scale=_FREE, axis=alt.Axis(format=".3~g", tickCount=5))
    bars = alt.Chart().mark_rule(strokeWidth=3).encode(low, alt.X2("high"), *y, tooltip=tooltip)
    means = alt.Chart().mark_point(filled=True, size=60, opacity=1).encode(_x("mean"), *y, tooltip=tooltip)
    panels = [
        alt.layer(bars, means, height=alt.Step(16), title=name).transform_filter(alt.datum.parameter == name)
        for name in names
    ]
    return _chart("parameters", "Parameters of the runs, 90 % intervals", _side_by_side(panels, across=2))


def _chart(
    table: str, description: str, drawn: Any, *params: alt.Parameter | alt.TopLevelSelectionParameter
) -> Specification:
    """A chart that the page embeds, of a table of the page, with the reader's choices."""
    look: Any = {"description": description, "background": "transparent", "config": _CONFIG}
    drawn = drawn.properties(data=alt.NamedData(name=table), **look)
    own = [] if drawn.params is alt.Undefined else drawn.params  # selections with a place in one of the panels
    drawn.params = [*(given.param if isinstance(given, alt.Parameter) else given for given in params), *own]
    with theme.enable("none"):  # independent of other settings of the process
        return drawn.to_dict()


def _side_by_side(panels: Sequence[Any], across: int) -> alt.ConcatChart:
    width = _WIDTH / min(len(panels), across) - 80
    return alt.concat(*(panel.properties(width=width) for panel in panels), columns=across)


def _number(channel: Any, name: str, **more: Any) -> Any:
    """A channel (`alt.X`, `alt.Size`, ...) that shows a column of numbers under its own name."""
    # Brackets and dots in a name have a meaning in Vega.
    plain = name.replace("\\", "\\\\").replace(".", "\\.").replace("[", "\\[").replace("]", "\\]")
    return channel(field=plain, **({"type": "quantitative", "title": name} | more))


def _word(channel: Any, name: str, **more: Any) -> Any:
    return _number(channel, name, type="nominal", **more)


def _x(name: str, **more: Any) -> alt.X:
    return _number(alt.X, name, **more)


def _y(name: str, **more: Any) -> alt.Y:
    return _number(alt.Y, name, **more)


def _split() -> alt.Shape:
    return _word(alt.Shape, "split", title=None, scale=alt.Scale(domain=["train", "test"], range=["circle", "square"]))


def _tooltip(words: Sequence[str], numbers: Sequence[str]) -> list[alt.Tooltip]:
    return [
        *(_word(alt.Tooltip, name) for name in words),
        *(_number(alt.Tooltip, name, format=".4g") for name in numbers),
    ]


def _color(names: Sequence[str]) -> alt.Color:
    scale = alt.Scale(domain=list(names), range=[_COLOURS[name] for name in names])
    return _word(alt.Color, "series", title=None, scale=scale)


def _look(keys: Iterable[str]) -> tuple[alt.Color, alt.StrokeDash, alt.Order]:
    """Colour and dashes of each series, its samples in order of time."""
    names = [SERIES[key] for key in keys]
    scale = alt.Scale(domain=names, range=[_DASHES[name] for name in names])
    return _color(names), _word(alt.StrokeDash, "series", title=None, scale=scale), alt.Order("time:Q")


def _folded(chart: alt.Chart, output: str, show: Mapping[str, alt.Parameter]) -> alt.Chart:
    """A row per sample and shown series, its value of an output in `value`."""
    shown = [(alt.datum.key == key) & chosen for key, chosen in show.items()]
    return (
        chart.transform_fold([f"{output}_{key}" for key in show], as_=["column", "value"])
        .transform_calculate(key=f"slice(datum.column, {len(output) + 1})")
        .transform_calculate(series=_named("key"))
        .transform_filter(reduce(or_, shown))
    )


def _named(column: str) -> str:
    """The name of a series in words, from the column that has its key."""
    names = ", ".join(f"{key}: '{name}'" for key, name in SERIES.items())
    return f"{{{names}}}[datum.{column}]"
