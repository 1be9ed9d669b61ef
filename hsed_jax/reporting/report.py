"""`report.html`: a run on one page, for readers who did not take part."""

import shlex
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from hsed_jax.criticism.prediction import error_cell
from hsed_jax.left_out import LeftOut
from hsed_jax.measurements import Campaign, Columns, backbone_table, cycle_table
from hsed_jax.physics import display
from hsed_jax.physics.effects import called
from hsed_jax.physics.names import named
from hsed_jax.physics.outputs import loops
from hsed_jax.plain import dump_yaml
from hsed_jax.reporting import page_tables as tables
from hsed_jax.reporting import style
from hsed_jax.reporting.asked import asked
from hsed_jax.reporting.digest import (
    behaviour,
    by_channel,
    diagnosed,
    diverged,
    error_text,
    key_figures,
    sentence,
    verdict,
    warnings,
)
from hsed_jax.reporting.finished import SPLITS, FinishedRun
from hsed_jax.reporting.inline_svg import InlineFigure, inline
from hsed_jax.reporting.page import number, render
from hsed_jax.reporting.probabilities import EXPLAINED
from hsed_jax.reporting.probabilities import shown as probability_text
from hsed_jax.tables import cell

_SHOWN, _CYCLES = 12, 40
_STILL = {
    "behaviour": ("behaviour",),
    "fall": ("error_fall",),
    "diagnosis": ("ranking",),
    "discovery": ("learned",),
    "improvement": ("parameters_before_after",),
    "design": ("fig5_expected_improvement", "fig6_exploration", "fig7_estimates", "fig4bis_one_experiment_map"),
    "bands": ("band_parts",),
    "cycles": ("cycles",),
    "posterior": ("posterior", "population"),
    "excitation": ("fig3_excitation", "fig4_loops_and_energy"),
}
"""Figures of the run folder that the page shows unchanged, by section."""


def report_page(run: FinishedRun, left_out: LeftOut | None = None) -> str:
    """The page of one run.

    Arguments:
        run: content of its folder.
        left_out: notes the charts and tables that cannot be made; the page lists them among its warnings.
    """
    left_out = left_out or LeftOut()

    def made[T](name: str, make: Callable[[FinishedRun], T], otherwise: T) -> T:
        return left_out.attempt(name, partial(make, run), otherwise)

    drawn: dict[str, Any] = {}
    data: dict[str, tables.Table] = {"experiments": made("table of errors", tables.experiments_table, {})}
    for name, make in _CHARTS.items():
        specification, columns = made(f"chart {name}", make, (None, {}))
        if specification is not None:
            drawn[name] = specification
        data |= columns
    no_table: dict[str, Any] = {"heads": [], "rows": []}
    content = {
        "asked": made("list of what was asked", lambda run: asked(run.study, run.campaign), []),
        "notes": [sentence(note) for note in run.summary.get("comparison", {}).get("notes", [])],
        "verdict": made("verdict", verdict, ""),
        "does": made("what the specimen does", behaviour, []),
        "diagnosed": made("verdict of the diagnosis", diagnosed, ""),
        "channels": made("table of the outputs", _channels, no_table),
        "doubtful": bool(diverged(run)),
        "scales": made("list of scales", _scales, ""),
        "falls": made("table of the fall of the error", _falls, []),
        "fall_notes": [*map(sentence, _fall_notes(run))],
        "figures": made("list of key figures", key_figures, []),
        "stills": {section: list(_stills(run, names, left_out)) for section, names in _STILL.items()},
        "ranking": made("table of effects", _ranking, no_table | {"named": [], "rest": 0}),
        "explained": EXPLAINED,
        "learned": sentence(run.summary.get("discovery", {}).get("sentence", "")),
        "places": made("table of places", _places, no_table),
        "experiments": made("table of experiments", _experiments, no_table | {"words": 3}),
        "cycles": made("table of cycles", partial(_read_cycles, cycle_table), no_table),
        "backbones": made("table of backbones", partial(_read_cycles, backbone_table), no_table),
        "references": made("list of references", _references, []),
        "repeat": _repeat(run),
        "written": dump_yaml(run.study),
    }
    known = made("list of warnings", lambda run: [*warnings(run)], [])
    return render(
        "report.html.j2",
        run=run,
        summary=run.summary,
        warnings=[*known, *map(sentence, left_out.sentences)],
        title=f"{run.name}: report",
        data={"charts": drawn, "tables": data},
        **content,
    )


Chart = tuple[dict[str, Any] | None, dict[str, tables.Table]]
"""A specification, and the tables that it draws; None without data for it."""


def _where_chart(run: FinishedRun) -> Chart:
    """The error of every experiment over the varying inputs."""
    from hsed_jax.reporting import charts  # Altair takes seconds to load, so it is imported only for a page

    shown = tables.experiments_table(run)
    if not shown:
        return None, {}
    inputs = [name for name in run.campaign.inputs if len({*shown[name]}) > 1]
    units = [tables.unit_words(run.campaign.unit(name).text) for name in inputs]
    largest = max((error for error in shown["error"] if error is not None), default=1.0)
    return charts.errors_over_inputs(list(zip(inputs, units, strict=True)), largest, list(run.comparisons)), {}


def _residual_chart(run: FinishedRun) -> Chart:
    """The residual of histories along each coordinate."""
    from hsed_jax.reporting import charts

    if not (_has_predictions(run) and run.observes_histories) or not (found := tables.residual_table(run)):
        return None, {}
    called = run.campaign.pair.called
    per_output = run.comparisons["before"]["train"]["per_output"]
    noise = {called(name): errors["noise_floor"] for name, errors in per_output.items()}
    coordinates, outputs = list(dict.fromkeys(found["coordinate"])), [*map(called, tables.outputs_of(run))]
    return charts.residual_along(coordinates, outputs, noise, list(run.predictions("train"))), {"residual": found}


def _histories_chart(run: FinishedRun) -> Chart:
    """Measured and predicted: histories of one experiment, or quantities of all."""
    from hsed_jax.reporting import charts

    if not _has_predictions(run):
        return None, {}
    axes, outputs, models = tables.axes_of(run), tables.outputs_of(run), list(run.predictions("train"))
    if not run.observes_histories:
        found = tables.quantities_table(run)
        return (charts.quantities(axes, outputs, models) if found else None), {"quantities": found}
    samples = tables.samples_table(run)
    known = [name.removesuffix("_measured") for name in samples if name.endswith("_measured")]
    prefixes = [named(owner, "") for owner in loops(known) if named(owner, "force") in outputs]
    # In the language of the charts, a dot selects a part of a value.
    data = {"samples": {_column(name): values for name, values in samples.items()}}
    if windows := tables.windows_table(run):
        data["windows"] = windows
    drawn = charts.histories(
        {_column(name): axis for name, axis in axes.items()},
        [_column(name) for name in outputs],
        models,
        "Time [s]" if run.campaign.has_time else "Row",
        [_column(prefix) for prefix in prefixes],
        bool(windows),
    )
    return drawn, data


_CHARTS: dict[str, Callable[[FinishedRun], Chart]] = {
    "where": _where_chart,
    "histories": _histories_chart,
    "residual": _residual_chart,
}
"""The interactive charts, by the name of their place in the page."""


def _has_predictions(run: FinishedRun) -> bool:
    return run.results is not None and "before" in run.comparisons


def _column(name: str) -> str:
    """The name of an output's column in the table behind the charts."""
    return name.replace(".", "·")


def _stills(run: FinishedRun, names: Sequence[str], left_out: LeftOut) -> Iterator[InlineFigure]:
    for name in names:
        for key, text in run.figures.items():
            # With several specimens there is one for each, with its name at the end.
            if key == name or key.startswith(f"{name}_"):
                figure = left_out.attempt(f"figure {key}", partial(inline, key, text), None)
                if figure is not None:
                    yield figure


def _experiments(run: FinishedRun) -> dict[str, Any]:
    """The table of the experiments: heads, and a row each."""
    campaign = run.campaign
    errors = {id: {model: tables.error_of(e) for model, e in models.items()} for _, id, models in run.errors()}
    heads = ["experiment", "split", "status"]
    heads += [f"{name} [{tables.unit_words(campaign.unit(name).text)}]" for name in campaign.inputs]
    heads += [
        f"{campaign.pair.called(name)} [{tables.unit_words(campaign.unit(name).text)}]" for name in campaign.quantities
    ]
    models = [*run.comparisons]
    heads += ["error" if model == "before" else f"error, {tables.SERIES[model]}" for model in models]
    rows = []
    for experiment in campaign:
        values = [campaign.unit(name).from_si(experiment.inputs[name]) for name in campaign.inputs]
        values += [
            campaign.unit(n).from_si(experiment.quantities[n]) if n in experiment.quantities else np.nan
            for n in campaign.quantities
        ]
        status = experiment.status + (f": {experiment.reason}" if experiment.reason else "")
        own = [errors.get(experiment.id, {}).get(model, np.nan) for model in models]
        numbers = [*map(number, values), *map(error_cell, own)]
        rows.append([experiment.id, experiment.split, status, *numbers])
    return {"heads": heads, "rows": rows, "words": 3}


def _read_cycles(make: Callable[[Campaign], Columns], run: FinishedRun) -> dict[str, Any]:
    """The measures of the cycles of component tests: heads, the first rows, and how many are left out."""
    # A shaken structure swings in hundreds of small cycles: `cycles.csv` has them.
    columns = make(run.campaign) if run.campaign.protocol == "displacement" else Columns("", [], [])
    words = sum("[" not in head for head in columns.heads)
    return {
        "heads": columns.heads,
        "rows": columns.cells()[:_CYCLES],
        "rest": len(columns.rows[_CYCLES:]),
        "words": words,
    }


def _ranking(run: FinishedRun) -> dict[str, Any]:
    """The first candidates of the diagnosis: heads, rows, which rows are named, and how many candidates are left out."""
    diagnosis = run.summary.get("diagnosis", {"ranking": [], "effects": []})
    heads = [
        "effect",
        "family",
        "size (90 % interval)",
        "probability",
        "predicts better by",
        "error, fitted",
        "error, not fitted",
    ]
    rows, named = [], []
    for candidate in diagnosis["ranking"][:_SHOWN]:
        named.append(candidate["effect"] in diagnosis["effects"])
        known = [(name, e) for name, e in candidate["estimate"].items() if "q05" in e]
        sizes = [_size(name, e) for name, e in known[: None if named[-1] else 1]]
        probability = candidate.get("probability", 0.0)
        numbers = [probability_text(probability, named[-1])]
        score = candidate.get("score")
        numbers += ["–" if score is None else f"{score['gain']:.1f} ± {score['standard_error']:.1f} nats"]
        numbers += [error_cell(candidate.get(key)) for key in ("error_train", "error_test")]
        means = {name: e["mean"] for name, e in candidate["estimate"].items() if "mean" in e}
        rows.append([style.words(called(candidate["effect"], means)), candidate["family"], "; ".join(sizes), *numbers])
    return {"heads": heads, "rows": rows, "named": named, "rest": len(diagnosis["ranking"]) - len(rows)}


def _places(run: FinishedRun) -> dict[str, Any]:
    """The places where the discovery searched: heads and rows."""
    tried = run.summary.get("discovery", {}).get("ranking", [])
    rows = [
        [
            run.campaign.pair.words(one["words"]),
            f"{one['probability']:.3f}",
            f"{one['log_evidence_gain']:.1f}",
            error_cell(one["error_train"]),
        ]
        for one in tried
    ]
    return {"heads": ["place", "probability", "log-evidence gain", "error, fitted"], "rows": rows}


def _falls(run: FinishedRun) -> list[tuple[str, str, str]]:
    """The first model, the model after each added effect, and the last one with its remainder, with their errors."""
    steps, has_test = run.summary.get("improvement", {}).get("steps", []), "test" in run.comparisons.get("before", {})
    rows = [
        (
            "+ " + style.words(called(step["effects"][-1], step.get("parameters", {})))
            if step["effects"]
            else "as it was",
            error_text(step, "error_train", ".4f"),
            error_text(step, "error_test", ".4f") if has_test else "–",
        )
        for step in steps
    ]
    if last := run.comparisons.get("remainder"):
        train, test = (error_text(last[split], look=".4f") for split in SPLITS)
        rows.append((tables.SERIES["remainder"], train, test))
    return rows


def _fall_notes(run: FinishedRun) -> list[str]:
    """How the improved model was made, and how much of what the last model leaves a function of the path explains."""
    improvement = run.summary.get("improvement", {})
    remainder = improvement.get("remainder")
    return [*improvement.get("notes", []), *([remainder["sentence"]] if remainder else [])]


def _channels(run: FinishedRun) -> dict[str, Any]:
    """The error of each output, before and after: heads and rows; empty for a single output, whose error is that of all."""
    found, models = by_channel(run.comparisons), list(run.comparisons)
    heads = ["split", "output", *(tables.SERIES[model] for model in models), "share of the squared error left"]
    rows = [
        [row["split"], run.campaign.pair.called(row["output"]), *(error_cell(row.get(model)) for model in models),
         f"{cell(100 * row['share'], '.0f')} %"]
        for row in found
    ]  # fmt: skip
    return {"heads": heads, "rows": rows if len({row["output"] for row in found}) > 1 else []}


def _scales(run: FinishedRun) -> str:
    """The characteristic values that amplitudes of effects are relative to, in readable units; empty without effects."""
    units = {"force": "N", "elongation": "m", "rate": "m/s", "energy": "J"}
    words = {"force": "force", "elongation": "elongation", "rate": "elongation rate", "energy": "absorbed energy"}
    pair, said = run.campaign.pair, []
    for name, value in run.summary.get("scales", {}).items():
        divisor, unit = display.shown_in(pair, units[name], np.asarray([value]))
        said.append(f"{pair.words(words[name])} {value / divisor:.3g} {tables.unit_words(unit)}".rstrip(" –"))
    return ", ".join(said)


def _size(name: str, estimate: dict[str, Any]) -> str:
    """Mean, 90 % interval and unit of a parameter."""
    mean, low, high = (number(estimate[key]) for key in ("mean", "q05", "q95"))
    return f"{name} {mean} ({low} … {high}) {tables.unit_words(estimate['unit'])}".rstrip(" –")


def _references(run: FinishedRun) -> list[tuple[str, str]]:
    """References of the law, of the effects in the model, of those named and added, and of the design."""
    found = [(name.replace("_", " "), text) for name, text in run.summary.get("references", {}).items()]
    if "design" in run.summary:
        found.append(
            ("sequential design", "G. Abbiati and S. Marelli, Sequential experimental design of hybrid simulations for Bayesian "
             "calibration of computational simulators, 17th World Conference on Earthquake Engineering, 2020")
        )  # fmt: skip
    return found


def _repeat(run: FinishedRun) -> list[str]:
    study = run.folder / "study.yaml"
    lines = [f"python -m hsed_jax.run {shlex.quote(str(study))} --output {shlex.quote(f'{run.folder}_again')}"]
    if (run.folder / "improved.yaml").exists():
        lines.append(f"python -m hsed_jax.run {shlex.quote(str(run.folder / 'improved.yaml'))}")
    return lines
