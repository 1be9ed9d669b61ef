"""The interactive charts of a report, as Vega-Lite specifications.

Data stay outside: a chart names its table (`page_tables`) and the page puts it there.  Colours are CSS variables of the page, so
that light, dark and print need no second chart.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from hsed_jax.reporting.page_tables import Axis

Specification = dict[str, Any]

INK, FAINT, GRID, BLUE, RED = (f"var(--{name})" for name in ("ink", "faint", "grid", "blue", "red"))
SERIES = {"measured": "measured", "before": "as it was", "after": "improved"}
"""What is drawn, by its key in the tables, in words."""

_COLOURS = {"measured": INK, "as it was": RED, "improved": BLUE, "noise": FAINT}
_DASHES = {"measured": [1, 0], "as it was": [7, 3], "improved": [1, 0]}
_SHAPES = {"domain": ["train", "test"], "range": ["circle", "square"]}
_ZOOM = "wheel![event.shiftKey]"  # the wheel alone moves the page
_WIDTH = 880
_CONFIG: Specification = {
    "font": "system-ui, sans-serif",
    "view": {"stroke": None},
    "axis": {
        "labelColor": INK, "titleColor": INK, "gridColor": GRID, "domainColor": FAINT, "tickColor": FAINT,
        "titleFontWeight": "normal", "labelFontSize": 11, "titleFontSize": 12,
    },
    "legend": {"labelColor": INK, "titleColor": INK, "titleFontWeight": "normal", "labelFontSize": 12, "orient": "top"},
    "title": {"color": INK, "fontWeight": "normal", "fontSize": 13, "anchor": "start"},
    "header": {"labelColor": INK, "titleColor": INK, "labelFontSize": 12},
}  # fmt: skip


def errors_over_inputs(inputs: Sequence[tuple[str, str]], largest: float, models: Sequence[str]) -> Specification:
    """The error of every experiment: on a map of two inputs, or against each of one or more, or side by side.

    Arguments:
        inputs: name and unit of the inputs that vary.
        largest: error of any model; all are drawn on its scale.
        models: `before`, and `after` where there is one.
    """
    chosen = "datum.experiment == experiment"
    point = {"type": "point", "filled": True, "stroke": INK, "opacity": 1, "cursor": "pointer"}
    common = {
        "tooltip": _tooltip(["experiment", "split"], [*(name for name, _ in inputs), "error"]),
        "shape": _field("split", "N", scale=_SHAPES, title=None),
        "strokeWidth": {"condition": {"test": chosen, "value": 3}, "value": 0.8},
    }  # fmt: skip
    if len(inputs) == 2:
        x, y = (_field(name, title=f"{name} [{unit}]", scale={"zero": False, "padding": 16}) for name, unit in inputs)
        error = _field("error", scale={"scheme": "yelloworangered", "domain": [0, largest]}, legend={"orient": "right"})
        size = _field("error", scale={"range": [60, 500], "domain": [0, largest]}, legend={"orient": "right"})
        drawn = {"mark": point, "encoding": {"x": x, "y": y, "color": error, "size": size, **common}}
        drawn |= {"width": 0.6 * _WIDTH, "height": 320}
    else:
        against = [_field(name, title=f"{name} [{unit}]", scale={"zero": False}) for name, unit in inputs]
        y = _field("error", scale={"domain": [0, largest]})
        drawn = _side_by_side(
            [
                {"mark": point | {"size": 90, "fill": BLUE}, "encoding": {"x": x, "y": y, **common}, "height": 230}
                for x in against or [_field("experiment", "N", axis={"labelAngle": 0})]
            ],
            across=3,
        )
    names = [SERIES[model] for model in models]
    shown = {"name": "model", "value": names[0], "bind": {"input": "select", "options": names, "name": "Model"}}
    transform = [_named("model"), {"filter": "datum.series == model"}]
    return _chart("experiments", "Error of every experiment", drawn, transform, [shown, _CHOSEN])


def residual_along(
    coordinates: Sequence[str], outputs: Sequence[str], noise: Mapping[str, float], models: Sequence[str]
) -> Specification:
    """The size of the residual along a coordinate that the reader chooses, with the noise as a dotted line.

    Arguments:
        coordinates, outputs: as the table `residual` names them.
        noise: over the RMS of the output, by output.
        models: `before`, and `after` where there is one.
    """
    x = _field("from", title=None, scale={"zero": False, "nice": False})
    y = _field("residual", title="RMS residual / RMS measured")
    color = _color([SERIES[model] for model in models])
    tooltip = _tooltip(["series"], ["from", "to", "residual"])
    panels = []
    for name in outputs:
        layers: list[Specification] = [
            {
                "mark": {"type": "rule", "strokeWidth": 2.5},
                "encoding": {"x": x, "x2": {"field": "to"}, "y": y, "color": color},
            },
            {
                "mark": {"type": "point", "size": 30, "filled": True, "opacity": 1},
                "encoding": {"x": _field("at"), "y": y, "color": color, "tooltip": tooltip},
            },
        ]
        if name in noise:
            rule = {"type": "rule", "color": INK, "strokeDash": [2, 3]}
            layers.append({"mark": rule, "encoding": {"y": {"datum": noise[name]}}})
        chosen = {"and": ["datum.coordinate == along", {"field": "output", "equal": name}]}
        panels.append({"transform": [{"filter": chosen}], "layer": layers, "height": 220, "title": name})
    along = {
        "name": "along",
        "value": coordinates[0],
        "bind": {"input": "select", "options": list(coordinates), "name": "Along"},
    }
    return _chart(
        "residual", "RMS residual along a coordinate", _side_by_side(panels, across=2), [_named("model")], [along]
    )


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
        models: `before`, and `after` where there is one.
        time: title of the time axis.
        loops: specimens whose force and elongation are both known, by what stands before the names of their outputs.
        windows: whether there are experiments of which a part is scored; it is shaded.
    """
    keys = ["measured", *models]
    width, height = (0.5 if loops else 0.88) * _WIDTH, max(150, 330 // len(outputs))
    last = outputs[-1]
    panels: list[Specification] = [
        {
            "layer": [
                *([_WINDOW] if windows else []),
                *_history(axes[name].label, name, time, keys, index, name == last),
            ],
            "width": width,
            "height": height,
        }
        for index, name in enumerate(outputs)
    ]
    drawn: Specification = {"vconcat": panels}
    # One zoom of the time axis for all outputs.
    linked = {"name": "zoom", "select": {"type": "interval", "encodings": ["x"], "zoom": _ZOOM}, "bind": "scales"}
    params: list[Specification] = [linked | {"views": [f"lines_{index}" for index in range(len(outputs))]}]
    drawn_loops = []
    for number, owner in enumerate(loops):
        along, force = f"{owner}elongation", f"{owner}force"
        imposed = f"datum['{along}_' + datum.key]"
        elongation = f"isValid({imposed}) ? {imposed} : datum['{along}_measured']"
        pan = {"name": f"pan_{number}", "select": {"type": "interval", "zoom": _ZOOM}, "bind": "scales"}
        tall = (height + 40) * len(outputs) - 40 if len(outputs) > 1 else height
        pairs = {
            # An elongation that was imposed is the same for all.
            "transform": [*_folded(force, keys), {"calculate": elongation, "as": "elongation"}],
            "mark": {"type": "line", "strokeWidth": 1.1, "clip": True},
            "encoding": {
                "x": _field("elongation", title=axes[along].label),
                "y": _field("value", title=axes[force].label),
                **_look(keys),
            },
            "params": [pan],
            "width": 0.36 * _WIDTH,
            "height": (tall + 40) / len(loops) - 40,
        }
        drawn_loops.append(pairs)
    if drawn_loops:
        drawn = {"hconcat": [{"vconcat": drawn_loops} if len(loops) > 1 else drawn_loops[0], drawn]}
    params += [
        {"name": f"show_{key}", "value": True, "bind": {"input": "checkbox", "name": SERIES[key]}} for key in keys
    ]
    only = [{"filter": "datum.experiment == experiment"}]
    return _chart(
        "samples", "Measured and predicted response of the chosen experiment", drawn, only, [*params, _CHOSEN]
    )


def _history(title: str, name: str, time: str, keys: Sequence[str], index: int, last: bool) -> list[Specification]:
    """Layers of one output over time: bands, lines, and the values under the pointer."""
    x = _field("time", title=time if last else None, scale={"nice": False})
    bands = [
        {
            "transform": [{"filter": f"show_{key}"}],
            "mark": {"type": "area", "color": _COLOURS[SERIES[key]], "opacity": 0.18, "clip": True},
            "encoding": {"x": x, "y": _field(f"{name}_{key}_low", title=title), "y2": {"field": f"{name}_{key}_high"}},
        }
        for key in keys[1:]
    ]
    lines = {
        "name": f"lines_{index}",
        "transform": _folded(name, keys),
        "mark": {"type": "line", "strokeWidth": 1.4, "clip": True},
        "encoding": {"x": x, "y": _field("value", title=title), **_look(keys)},
    }
    under = f"under_{index}"
    nearest = {"type": "point", "nearest": True, "on": "pointerover", "clear": "pointerout", "encodings": ["x"]}
    values = [_field(f"{name}_{key}", title=SERIES[key], format=".4g") for key in keys]
    spots = {
        # Invisible, one per sample: what is nearest to the pointer.
        "mark": {"type": "point", "opacity": 0, "clip": True},
        "params": [{"name": under, "select": nearest}],
        "encoding": {
            "x": x,
            "y": _field(f"{name}_measured", title=title),
            "tooltip": [_field("time", title=time), *values],
        },
    }
    rule = {
        "mark": {"type": "rule", "color": FAINT, "clip": True},
        "encoding": {"x": x, "opacity": {"condition": {"param": under, "empty": False, "value": 1}, "value": 0}},
    }
    return [*bands, lines, rule, spots]


def quantities(axes: Mapping[str, Axis], names: Sequence[str], models: Sequence[str]) -> Specification:
    """Predicted against measured quantities with 90 % bands; the experiment that the page chooses stands out."""
    color, panels = _color([SERIES[model] for model in models]), []
    for name in names:
        words, _, unit = axes[name]
        x = _field("measured", title=f"{words}, measured [{unit}]", scale={"zero": False})
        y = _field("predicted", title=f"predicted [{unit}]", scale={"zero": False})
        tooltip = _tooltip(["experiment", "split", "series"], ["measured", "predicted"])
        layers = [
            {"mark": {"type": "line", "color": FAINT, "strokeWidth": 1}, "encoding": {"x": x, "y": _field("measured")}},
            {
                "mark": {"type": "rule", "opacity": 0.45},
                "encoding": {"x": x, "y": _field("low"), "y2": {"field": "high"}, "color": color},
            },
            {
                "mark": {"type": "point", "filled": True, "opacity": 1},
                "encoding": {
                    "x": x, "y": y, "color": color, "tooltip": tooltip, "shape": _field("split", "N", scale=_SHAPES, title=None),
                    "size": {"condition": {"test": "datum.experiment == experiment", "value": 240}, "value": 45},
                },
            },
        ]  # fmt: skip
        panels.append({"transform": [{"filter": {"field": "quantity", "equal": name}}], "layer": layers, "height": 230})
    return _chart(
        "quantities",
        "Predicted against measured quantities",
        _side_by_side(panels, across=3),
        [_named("model")],
        [_CHOSEN],
    )


def errors_by_run() -> Specification:
    """The normalised error of every run, before and after, on fitted and held-out experiments."""
    order = ["train", "test", "noise"]
    drawn = {
        "mark": {"type": "bar", "height": 10},
        "encoding": {
            "x": _field("error", title="normalised error"), "y": _field("split", "N", title=None, sort=order),
            "yOffset": {"field": "series"}, "color": _color(["as it was", "improved", "noise"]),
            "row": _field("run", "N", title=None, header={"labelAngle": 0, "labelAlign": "left", "labelOrient": "top"}),
            "tooltip": _tooltip(["run", "split", "series"], ["error"]),
        },
        "width": 0.7 * _WIDTH,
        "height": {"step": 12},
    }  # fmt: skip
    return _chart("errors", "Normalised error of the runs", drawn, [], [])


def intervals(names: Sequence[str]) -> Specification:
    """Posterior means and 90 % intervals: a panel per parameter, a row per run and model."""
    color, panels = _color(["as it was", "improved"]), []
    for name in names:
        y = {"y": _field("run", "N", title=None), "yOffset": {"field": "series"}, "color": color}
        tooltip = _tooltip(["run", "series"], ["mean", "low", "high"])
        x = _field("low", title=None, scale={"zero": False}, axis={"format": ".3~g", "tickCount": 5})
        layers = [
            {
                "mark": {"type": "rule", "strokeWidth": 3},
                "encoding": {"x": x, "x2": {"field": "high"}, **y, "tooltip": tooltip},
            },
            {
                "mark": {"type": "point", "filled": True, "size": 60, "opacity": 1},
                "encoding": {"x": _field("mean"), **y, "tooltip": tooltip},
            },
        ]
        chosen = [{"filter": {"field": "parameter", "equal": name}}]
        panels.append({"transform": chosen, "layer": layers, "height": {"step": 16}, "title": name})
    return _chart("parameters", "Parameters of the runs, 90 % intervals", _side_by_side(panels, across=2), [], [])


_CHOSEN: Specification = {"name": "experiment", "value": ""}
_WINDOW: Specification = {
    "data": {"name": "windows"},
    "transform": [{"filter": "datum.experiment == experiment"}],
    "mark": {"type": "rect", "color": FAINT, "opacity": 0.15, "clip": True},
    "encoding": {"x": {"field": "from", "type": "quantitative"}, "x2": {"field": "to"}},
}


def _chart(
    table: str, description: str, drawn: Specification, transform: list[Specification], params: list[Specification]
) -> Specification:
    return {
        "$schema": "https://vega.github.io/schema/vega-lite/v6.json",
        "description": description,
        "background": "transparent",
        "config": _CONFIG,
        "data": {"name": table},
        "transform": transform,
        "params": params,
        **drawn,
    }


def _side_by_side(panels: list[Specification], across: int) -> Specification:
    width = _WIDTH / min(len(panels), across) - 80
    return {"concat": [panel | {"width": width} for panel in panels], "columns": across}


def _field(name: str, kind: str = "Q", **more: Any) -> Specification:
    # Brackets and dots in a name mean something to Vega.
    plain = name.replace("\\", "\\\\").replace(".", "\\.").replace("[", "\\[").replace("]", "\\]")
    return {"field": plain, "type": {"Q": "quantitative", "N": "nominal"}[kind], **({"title": name} | more)}


def _tooltip(words: Sequence[str], numbers: Sequence[str]) -> list[Specification]:
    return [*(_field(name, "N") for name in words), *(_field(name, format=".4g") for name in numbers)]


def _color(names: Sequence[str]) -> Specification:
    return _field("series", "N", title=None, scale={"domain": list(names), "range": [_COLOURS[name] for name in names]})


def _look(keys: Sequence[str]) -> Specification:
    """Colour and dashes of each series, its samples in order of time."""
    names = [SERIES[key] for key in keys]
    dashes = _field("series", "N", title=None, scale={"domain": names, "range": [_DASHES[name] for name in names]})
    return {"color": _color(names), "strokeDash": dashes, "order": {"field": "time", "type": "quantitative"}}


def _folded(output: str, keys: Sequence[str]) -> list[Specification]:
    """A row per sample and shown series, its value of an output in `value`."""
    return [
        {"fold": [f"{output}_{key}" for key in keys], "as": ["column", "value"]},
        {"calculate": f"slice(datum.column, {len(output) + 1})", "as": "key"},
        _named("key"),
        {"filter": " || ".join(f"(datum.key == '{key}' && show_{key})" for key in keys)},
    ]


def _named(column: str) -> Specification:
    """The name of a series in words, from the column that has its key."""
    names = ", ".join(f"{key}: '{name}'" for key, name in SERIES.items())
    return {"calculate": f"{{{names}}}[datum.{column}]", "as": "series"}
