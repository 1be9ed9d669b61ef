"""A finished run in brief: its verdict in a sentence, the key figures, and the warnings to read first."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from hsed_jax.criticism.prediction import error_cell, error_change
from hsed_jax.physics.effects import called
from hsed_jax.reporting import style
from hsed_jax.reporting.finished import MODELS, SPLITS, FinishedRun
from hsed_jax.reporting.probabilities import shown

_QUOTED = 5  # doubts of the data


def verdict(run: FinishedRun) -> str:
    """The behaviour of the specimen and the result of the run, a sentence each, after a warning on estimates on bounds."""
    does = run.summary.get("diagnosis", {}).get("behaviour_sentence", "")
    return " ".join([*_cautions(run), *([sentence(does)] if does else []), _found(run)])


def behaviour(run: FinishedRun) -> list[str]:
    """The behaviour of the specimen with the named effects, a sentence each."""
    return [sentence(one["sentence"]) for one in run.summary.get("diagnosis", {}).get("behaviour", [])]


def _cautions(run: FinishedRun) -> Iterator[str]:
    """The warning to read before using the estimates of the last model.

    An added effect may move an estimate of the first model away from its bound, so the warning on the first model is shown,
    too.
    """
    if caution := run.summary.get(_last_model(run), {}).get("caution"):
        yield sentence(f"of the improved model, {caution}" if _last_model(run) == "improvement" else caution)


def _last_model(run: FinishedRun) -> str:
    """The part of the summary that has the estimates of the last model."""
    return "improvement" if len(run.summary.get("improvement", {}).get("steps", [])) > 1 else "calibration"


def _found(run: FinishedRun) -> str:
    summary = run.summary
    if improved := _improved(summary):
        # An ambiguous result stays ambiguous for any fall of the error.
        unsure = summary.get("diagnosis", {}).get("verdict", "missing_effects") != "missing_effects"
        return f"{improved} {diagnosed(run)}" if unsure else improved
    if "diagnosis" in summary:
        return diagnosed(run)
    if "comparison" in summary:
        comparison = summary["comparison"]
        error, floor = error_text(comparison["train"]), comparison["train"]["noise_floor"]
        if comparison["adequate"]:
            return f"The noise explains the residual: error {error}, noise {floor:.3f}."
        if "p_value" not in comparison:
            return f"No noise is declared, so it is unknown whether the noise explains the residual; error {error}."
        return f"The noise does not explain the residual: error {error}, noise {floor:.3f}."
    if "calibration" in summary:
        said = ", ".join(f"{name} = {value:.4g}" for name, value in summary["calibration"]["map"].items())
        only = "" if "compare" in run.study["steps"] else " The model was not checked (steps: compare, diagnose)."
        count = len(run.campaign.train)
        return f"Calibrated on {count} experiment{'s' if count > 1 else ''}: {said} (SI).{only}"
    return "There is no result yet."


def diagnosed(run: FinishedRun) -> str:
    """The result of the diagnosis in one sentence; empty without a diagnosis."""
    return sentence(run.summary["diagnosis"]["sentence"]) if "diagnosis" in run.summary else ""


def _improved(summary: Mapping[str, Any]) -> str:
    """The fall of the error, and whether the rest is noise; empty if no effect was added."""
    improvement = summary.get("improvement", {})
    first, *rest = improvement.get("steps", [{}])
    if not rest:
        return ""
    last, comparison = rest[-1], improvement["comparison"]
    key, which = "error_train", "the fitted experiments"
    if "test" in comparison:
        key, which = "error_test", "experiments that were not fitted"
    sizes = last.get("parameters", {})
    added = " and ".join(style.words(called(effect, sizes)) for effect in last["effects"])
    change = error_change(error_text(first, key), error_text(last, key))
    said = f"With {added} the error on {which} {change} (noise {improvement['noise_floor']:.3f})."
    if "p_value" not in comparison:
        return f"{said} No noise is declared, so it is unknown whether the noise explains the rest."
    return f"{said} The noise {'explains' if comparison['adequate'] else 'does not explain'} the rest."


def by_channel(comparisons: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The error of each output, which the error over all outputs may conceal: a row per split and output.

    Arguments:
        comparisons: `FinishedRun.comparisons`.

    Returns:
        Split, output, error by model, and the `share` of the squared error of the last model that the output has.
    """
    rows, models = [], list(comparisons)
    for split in SPLITS:
        parts = {model: comparisons[model][split]["per_output"] for model in models if split in comparisons[model]}
        if not parts:
            continue
        last = parts[[*parts][-1]]
        squares = {output: errors.get("nrmse", math.inf) ** 2 for output, errors in last.items()}
        total = sum(squares.values())
        for output, square in squares.items():
            errors = {model: own[output].get("nrmse", math.inf) for model, own in parts.items() if output in own}
            share = square / total if math.isfinite(total) and total > 0 else math.nan
            rows.append({"split": split, "output": output, **errors, "share": share})
    return rows


def key_figures(run: FinishedRun) -> list[dict[str, Any]]:
    """The key figures: a label, the number, and its displayed text."""
    summary, found = run.summary, []

    def add(key: str, label: str, value: float | None, form: str = "{:.3f}") -> None:
        if value is not None:
            found.append({"key": key, "label": label, "value": value, "text": form.format(value)})

    for split, words in (("train", "fitted"), ("test", "held out")):
        for model, comparison in run.comparisons.items():
            if split in comparison:
                label = f"error, {words} experiments, {MODELS[model]}"
                error, text = comparison[split].get("error"), error_text(comparison[split])
                found.append({"key": f"error_{split}_{model}", "label": label, "value": error, "text": text})
    if before := run.comparisons.get("before"):
        add("noise_floor", "noise floor", before["train"]["noise_floor"])
    diagnosis = summary.get("diagnosis")
    if diagnosis:
        by_name = {candidate["effect"]: candidate for candidate in diagnosis["ranking"]}
        for effect in diagnosis["effects"]:
            probability = by_name[effect]["probability"]
            label = f"probability of {effect.replace('_', ' ')}"
            text = shown(probability, is_named=True)
            found.append({"key": f"probability_{effect}", "label": label, "value": probability, "text": text})
    if "design" in summary:
        add("experiments", "experiments", len(summary["design"]["inputs"]), "{:d}")
        improvement = summary["design"]["max_expected_improvement"]
        if improvement:
            add("max_expected_improvement", "largest expected improvement at the last step", improvement[-1], "{:.2e}")
    return found


def warnings(run: FinishedRun) -> Iterator[str]:
    """The warnings that a reader must know first."""
    if run.summary["status"] != "complete":
        yield f"The run is not complete ({run.summary['status']}); the report shows the results until it stopped."
    yield from (f"{words}: {text}." for words, texts in diverged(run).items() for text in texts)
    first = "the model as it was" if "improvement" in run.summary else "the model"
    for model, part in ((first, "calibration"), ("the improved model", "improvement")):
        found = run.summary.get(part, {})
        if part != _last_model(run) and (caution := found.get("caution")):
            yield f"Of {model}: {caution}."
        if text := found.get("warning"):
            yield f"The draws of the posterior of {model} have not converged: {text}."
        if doubt := found.get("doubt"):
            yield sentence(doubt.replace("the model", model, 1))
        if apart := found.get("disagreement"):
            yield f"Of {model}: {apart['sentence']}."
    yield from map(sentence, run.summary.get("left_out", []))
    if said := run.summary.get("design", {}).get("drift"):
        yield sentence(said)
    for finding in run.findings[:_QUOTED]:
        yield sentence(f"the data check has {'an' if finding.level == 'error' else 'a'} {finding}")
    if rest := len(run.findings[_QUOTED:]):
        yield f"The data check has {rest} more doubt{'s' if rest > 1 else ''}, listed under “Data”."
    if failed := [e.id for e in run.campaign if e.status == "failed"]:
        yield f"Experiments that failed: {', '.join(failed)}."


def diverged(run: FinishedRun) -> dict[str, list[str]]:
    """The message on diverged simulations, by model."""
    found = {f"The {MODELS[model]}": comparison.get("warnings", []) for model, comparison in run.comparisons.items()}
    return {model: texts for model, texts in found.items() if texts}


def error_text(entry: Mapping[str, Any], key: str = "error", look: str = ".3f") -> str:
    """An error of the summary; an error that is not finite is absent there."""
    return error_cell(entry.get(key, math.inf), look)


def sentence(text: str) -> str:
    """A text as a sentence: its first letter large, a full stop unless it ends already."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '?')) else '.'}"
