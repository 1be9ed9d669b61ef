"""A finished run from its folder: the content of its report."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import xarray as xr

from hsed_jax.measurements import Campaign, Finding, check_campaign
from hsed_jax.tables import Table, Tabular, cell

SPLITS = ("train", "test")
MODELS = {"before": "model as it was", "after": "improved model", "remainder": "model with the remainder"}
"""The models of a run in words."""


@dataclass(frozen=True, repr=False)
class FinishedRun(Tabular):
    """The content of a run folder.

    Attributes:
        folder: of the run.
        study: the study with every default written out.
        summary: `summary.json`.
        provenance: versions, machine, sessions.
        campaign: the experiments.
        results: `results.nc`; None of a run that was interrupted.
        figures: SVG by name.
        export_check: content of `check.json` of its export; None without a checked script.
    """

    folder: Path
    study: dict[str, Any]
    summary: dict[str, Any]
    provenance: dict[str, Any]
    campaign: Campaign
    results: xr.DataTree | None
    figures: dict[str, str]
    export_check: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.summary["study"]

    def _table(self) -> Table:
        rows = [
            (f"error of {split}, {when}", cell(comparison[split].get("error")))
            for when, comparison in ((MODELS[model], comparison) for model, comparison in self.comparisons.items())
            for split in SPLITS
            if split in comparison
        ]
        diagnosis = self.summary.get("diagnosis", {})
        notes = [diagnosis["sentence"]] if "sentence" in diagnosis else []
        return Table(f"run {self.name} in {self.folder}: {self.summary['status']}", rows=rows, notes=notes)

    @property
    def comparisons(self) -> dict[str, dict[str, Any]]:
        """`comparison` of the first model (`before`), of the improved one (`after`), and of the last one with a remainder that
        helps (`remainder`), if they exist.
        """
        improvement = self.summary.get("improvement", {})
        remainder = improvement.get("remainder", {})
        found = {
            "before": self.summary.get("comparison"),
            "after": improvement.get("comparison"),
            "remainder": remainder.get("comparison") if remainder.get("helps") else None,
        }
        return {name: comparison for name, comparison in found.items() if comparison}

    @cached_property
    def findings(self) -> list[Finding]:
        """The findings of the check of the data."""
        return check_campaign(self.campaign)

    @property
    def observes_histories(self) -> bool:
        """Whether histories were fitted; otherwise quantities."""
        return self.study.get("observe") == "histories"

    def predictions(self, split: str) -> dict[str, xr.DataTree]:
        """Predictions of a split by model, as `comparisons`; empty where none were made."""
        if self.results is None:
            return {}
        roots = {"before": "predictions", "after": "predictions_improved", "remainder": "predictions_with_remainder"}
        groups = {model: f"{root}/{split}" for model, root in roots.items()}
        known = {path.strip("/") for path in self.results.groups}
        return {model: self.results[path] for model, path in groups.items() if path in known}  # type: ignore[misc]

    def errors(self) -> Iterator[tuple[str, str, dict[str, dict[str, dict[str, float]]]]]:
        """Every compared experiment: its split, its id, and its errors by model and output."""
        for split in SPLITS:
            by_model = {model: c[split]["per_experiment"] for model, c in self.comparisons.items() if split in c}
            for id in by_model.get("before", {}):
                yield split, id, {model: errors[id] for model, errors in by_model.items() if id in errors}
