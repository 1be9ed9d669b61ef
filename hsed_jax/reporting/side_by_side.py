"""Several runs on one page: verdicts, figures, parameters, and the differences of their settings."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import yaml

from hsed_jax.reporting.digest import key_figures, verdict, warnings
from hsed_jax.reporting.finished import SPLITS, FinishedRun
from hsed_jax.reporting.page import render
from hsed_jax.reporting.page_tables import SERIES, columns


def comparison_page(runs: Sequence[FinishedRun]) -> str:
    """The page of several runs side by side."""
    from hsed_jax.reporting import charts  # Altair takes seconds to load, so it is imported only for a page

    names = _distinct(runs)
    named = list(zip(names, runs, strict=True))
    errors = [row for name, run in named for row in _errors(name, run)]
    parameters = [row for name, run in named for row in _parameters(name, run)]
    shared = list(dict.fromkeys(row["parameter"] for row in parameters))
    drawn: dict[str, Any] = {}
    if errors:
        drawn["errors"] = charts.errors_by_run()
    if shared:
        drawn["parameters"] = charts.intervals(shared)
    return render(
        "comparison.html.j2",
        runs=named,
        verdicts=[verdict(run) for run in runs],
        figures=_side_by_side([key_figures(run) for run in runs]),
        warnings=[(name, text) for name, run in named for text in warnings(run)],
        settings=_differences([run.study for run in runs]),
        versions=_differences([run.provenance.get("versions", {}) for run in runs]),
        title=f"{' and '.join(names)}: side by side",
        data={"charts": drawn, "tables": {"errors": columns(errors), "parameters": columns(parameters)}},
    )


def _errors(name: str, run: FinishedRun) -> Iterator[dict[str, Any]]:
    for model, comparison in run.comparisons.items():
        for split in SPLITS:
            if split in comparison:
                error = comparison[split].get("error")
                yield {"run": name, "split": split, "series": SERIES[model], "error": error}
    if "before" in run.comparisons:
        floor = run.comparisons["before"]["train"]["noise_floor"]
        yield {"run": name, "split": "noise", "series": "noise", "error": floor}


def _parameters(name: str, run: FinishedRun) -> Iterator[dict[str, Any]]:
    for model, part in (("before", "calibration"), ("after", "improvement")):
        for parameter, s in run.summary.get(part, {}).get("posterior", {}).items():
            row = {"run": name, "series": SERIES[model], "parameter": parameter}
            yield row | {"mean": s["mean"], "low": s["q05"], "high": s["q95"]}


def _side_by_side(figures: list[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Key figures as rows: a label, and a cell per run."""
    labels = {figure["key"]: figure["label"] for run in figures for figure in run}
    cells = [{figure["key"]: figure for figure in run} for run in figures]
    return [{"label": label, "cells": [run.get(key) for run in cells]} for key, label in labels.items()]


def _differences(contents: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Keys (dotted) whose values differ, with the value of each."""
    flat = [dict(_flat(content)) for content in contents]
    keys = list(dict.fromkeys(key for content in flat for key in content))
    rows = [(key, [_text(content.get(key, "–")) for content in flat]) for key in keys]
    return [(key, values) for key, values in rows if len(set(values)) > 1]


def _text(value: Any) -> str:
    """A value as in a study."""
    return yaml.safe_dump(value, default_flow_style=True, width=1000).strip() if isinstance(value, list) else str(value)


def _flat(content: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def _distinct(runs: Sequence[FinishedRun]) -> list[str]:
    """Names that distinguish the runs: of the studies, or of the folders."""
    for names in ([run.name for run in runs], [run.folder.name for run in runs]):
        if len(set(names)) == len(names):
            return names
    return [str(run.folder) for run in runs]
