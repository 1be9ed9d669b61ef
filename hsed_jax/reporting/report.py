"""`report.html`: a run on one page, for who was not there."""

import shlex
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hsed_jax.criticism.prediction import error_cell
from hsed_jax.physics.outputs import loops, named
from hsed_jax.plain import dump_yaml
from hsed_jax.reporting import page_tables as tables
from hsed_jax.reporting import style
from hsed_jax.reporting.asked import asked
from hsed_jax.reporting.digest import diverged, error_text, key_figures, sentence, verdict, warnings
from hsed_jax.reporting.finished import FinishedRun
from hsed_jax.reporting.inline_svg import InlineFigure, inline
from hsed_jax.reporting.page import number, render

_SHOWN = 12
_STILL = {
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
"""Figures of the run folder that stand in the page as they are, by section."""


def report_page(run: FinishedRun) -> str:
    """The page of one run."""
    drawn, data = _charts(run)
    stills = {section: list(_stills(run, names)) for section, names in _STILL.items()}
    return render(
        "report.html.j2",
        run=run,
        summary=run.summary,
        asked=asked(run.study, run.campaign),
        notes=[sentence(note) for note in run.summary.get("comparison", {}).get("notes", [])],
        verdict=verdict(run),
        doubtful=bool(diverged(run)),
        scales=_scales(run),
        falls=_falls(run),
        figures=key_figures(run),
        warnings=list(warnings(run)),
        stills=stills,
        ranking=_ranking(run),
        learned=sentence(run.summary.get("discovery", {}).get("sentence", "")),
        places=_places(run),
        experiments=_experiments(run),
        references=_references(run),
        repeat=_repeat(run),
        written=dump_yaml(run.study),
        title=f"{run.name}: report",
        data={"charts": drawn, "tables": data},
    )


def _charts(run: FinishedRun) -> tuple[dict[str, Any], dict[str, tables.Table]]:
    """Specifications and tables of the interactive charts that there is material for."""
    from hsed_jax.reporting import charts  # Altair takes seconds to load: only who writes a page waits for it

    drawn: dict[str, Any] = {}
    data = {"experiments": tables.experiments_table(run)}
    if data["experiments"]:
        campaign, shown = run.campaign, data["experiments"]
        inputs = [name for name in campaign.inputs if len({*shown[name]}) > 1]
        units = [tables.unit_words(campaign.unit(name).text) for name in inputs]
        largest = max((error for error in shown["error"] if error is not None), default=1.0)
        drawn["where"] = charts.errors_over_inputs(
            list(zip(inputs, units, strict=True)), largest, list(run.comparisons)
        )
    if run.results is None or "before" not in run.comparisons:
        return drawn, data
    axes, models = tables.axes_of(run), list(run.predictions("train"))
    outputs = tables.outputs_of(run)
    if run.observes_histories:
        data |= {"samples": tables.samples_table(run), "residual": tables.residual_table(run)}
        time = "Time [s]" if run.campaign.has_time else "Row"
        known = [name.removesuffix("_measured") for name in data["samples"] if name.endswith("_measured")]
        found = [named(owner, "") for owner in loops(known) if named(owner, "force") in outputs]
        # In the language of the charts a dot would lead into a value.
        data["samples"] = {_column(name): values for name, values in data["samples"].items()}
        drawable = {_column(name): axis for name, axis in axes.items()}
        pairs = [_column(prefix) for prefix in found]
        if windows := tables.windows_table(run):
            data["windows"] = windows
        drawn["histories"] = charts.histories(
            drawable, [_column(name) for name in outputs], models, time, pairs, bool(windows)
        )
        if data["residual"]:
            noise = {
                campaign.pair.called(name): v["noise_floor"]
                for name, v in run.comparisons["before"]["train"]["per_output"].items()
            }
            said = [*map(campaign.pair.called, outputs)]
            drawn["residual"] = charts.residual_along(
                list(dict.fromkeys(data["residual"]["coordinate"])), said, noise, models
            )
    else:
        data["quantities"] = tables.quantities_table(run)
        if data["quantities"]:
            drawn["histories"] = charts.quantities(axes, outputs, models)
    return drawn, data


def _column(name: str) -> str:
    """What the column of an output is called in the table behind the charts."""
    return name.replace(".", "·")


def _stills(run: FinishedRun, names: Sequence[str]) -> Iterator[InlineFigure]:
    # Of several specimens there is one for each, with its name behind.
    for name in names:
        yield from (inline(key, f) for key, f in run.figures.items() if key == name or key.startswith(f"{name}_"))


def _experiments(run: FinishedRun) -> dict[str, Any]:
    """The table of the experiments: heads, and a row each."""
    campaign = run.campaign
    errors = {id: {model: tables.error_of(e) for model, e in models.items()} for _, id, models in run.errors()}
    heads = ["experiment", "split", "status"]
    heads += [f"{name} [{tables.unit_words(campaign.unit(name).text)}]" for name in campaign.inputs]
    heads += [
        f"{campaign.pair.called(name)} [{tables.unit_words(campaign.unit(name).text)}]" for name in campaign.quantities
    ]
    models = [model for model in ("before", "after") if model in run.comparisons]
    heads += [{"before": "error", "after": "error, improved"}[model] for model in models]
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


def _ranking(run: FinishedRun) -> dict[str, Any]:
    """The first candidates of the diagnosis: heads, rows, which rows are named, and how many candidates are left out."""
    diagnosis = run.summary.get("diagnosis", {"ranking": [], "effects": []})
    heads = [
        "effect",
        "family",
        "size (90 % interval)",
        "probability",
        "log-evidence gain",
        "error, fitted",
        "error, not used",
    ]
    rows, named = [], []
    for candidate in diagnosis["ranking"][:_SHOWN]:
        named.append(candidate["effect"] in diagnosis["effects"])
        known = [(name, e) for name, e in candidate["estimate"].items() if "q05" in e]
        sizes = [_size(name, e) for name, e in known[: None if named[-1] else 1]]
        forms = {"probability": "{:.3f}", "log_evidence_gain": "{:.1f}"}
        numbers = [form.format(candidate[key]) if key in candidate else "–" for key, form in forms.items()]
        numbers += [error_cell(candidate.get(key)) for key in ("error_train", "error_test")]
        rows.append([style.words(candidate["effect"]), candidate["family"], "; ".join(sizes), *numbers])
    return {"heads": heads, "rows": rows, "named": named, "rest": len(diagnosis["ranking"]) - len(rows)}


def _places(run: FinishedRun) -> dict[str, Any]:
    """The places where something was looked for that the catalogue does not hold: heads and rows."""
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
    """The model as it was and after each added effect, with its errors."""
    steps, has_test = run.summary.get("improvement", {}).get("steps", []), "test" in run.comparisons.get("before", {})
    return [
        (
            "+ " + style.words(step["effects"][-1]) if step["effects"] else "as it was",
            error_text(step, "error_train", ".4f"),
            error_text(step, "error_test", ".4f") if has_test else "–",
        )
        for step in steps
    ]


def _scales(run: FinishedRun) -> str:
    """The characteristic values that amplitudes of effects are relative to, in readable units; empty without effects."""
    units = {"force": "N", "elongation": "m", "rate": "m/s", "energy": "J"}
    words = {"force": "force", "elongation": "elongation", "rate": "elongation rate", "energy": "absorbed energy"}
    pair, said = run.campaign.pair, []
    for name, value in run.summary.get("scales", {}).items():
        divisor, unit = style.readable(pair.unit(units[name]), np.asarray([value]))
        said.append(f"{pair.words(words[name])} {value / divisor:.3g} {tables.unit_words(unit)}".rstrip(" –"))
    return ", ".join(said)


def _size(name: str, estimate: dict[str, Any]) -> str:
    """Mean, 90 % interval and unit of a parameter."""
    mean, low, high = (number(estimate[key]) for key in ("mean", "q05", "q95"))
    return f"{name} {mean} ({low} … {high}) {tables.unit_words(estimate['unit'])}".rstrip(" –")


def _references(run: FinishedRun) -> list[tuple[str, str]]:
    """Of the law, of the effects in the model, of those named and added, and of the design."""
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
