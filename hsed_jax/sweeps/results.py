"""The results of a sweep, as a table, a dataset and a list of failures, made from its folder."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from hsed_jax.sweeps.folder import outcomes, run_folder
from hsed_jax.sweeps.plan import Plan, described

_ESTIMATES = ("map", "mean", "sd", "q05", "q95", "rhat", "ess_bulk")


def table_of(path: Path, plan: Plan) -> pd.DataFrame:
    """A row per study, `number` (from 1) as index.

    Columns: the swept keys by dotted path (as JSON unless it is a number or a word); `status` (`complete`, `failed`,
    `pending`), `message`, `seconds`; then the contents of the summaries, if the steps ran: `map.A`, `mean.A`, `sd.A`,
    `q05.A`, `q95.A`, `rhat.A`, `ess_bulk.A` of every parameter (SI), `divergences`, `log_evidence`, `error_train`,
    `error_test`, `noise_floor`, `adequate`, `p_value`, `verdict`, `effects`, `error_train_improved`, `error_test_improved`,
    `experiments`, `max_expected_improvement` at the end.
    """
    rows = []
    for number, (point, ended) in enumerate(zip(plan.points, outcomes(path, len(plan.points)), strict=True)):
        row = {key: _scalar(point[key]) if key in point else None for key in plan.keys}
        row |= {name: ended.get(name) for name in ("status", "message", "seconds")}
        if ended["status"] == "complete":
            text = (run_folder(path, number) / "summary.json").read_text(encoding="utf-8")
            row |= scalars(json.loads(text))
        rows.append(row)
    table = pd.DataFrame(rows, index=pd.RangeIndex(1, len(rows) + 1, name="number"))
    truths = {name: "boolean" for name in ("adequate",) if name in table}
    table = table.astype({"message": "str", "seconds": float, **truths})
    for key in plan.keys:
        if any(isinstance(value, str) for value in table[key]):
            # A file of columns holds one kind of value in each.
            table[key] = table[key].map(lambda value: value if isinstance(value, str) else json.dumps(value))
    return table


def scalars(summary: dict[str, Any]) -> dict[str, Any]:
    """The figures of a `summary.json` that studies are compared by; see `table_of`."""
    found: dict[str, Any] = {}
    if calibration := summary.get("calibration"):
        found |= {f"map.{name}": value for name, value in calibration["map"].items()}
        for name, about in calibration["posterior"].items():
            found |= {f"{kind}.{name}": about[kind] for kind in _ESTIMATES if kind in about}
        found |= {name: calibration[name] for name in ("divergences", "log_evidence") if name in calibration}
    if comparison := summary.get("comparison"):
        for split in ("train", "test"):
            if split in comparison:
                found[f"error_{split}"] = comparison[split].get("error")
        found["noise_floor"] = comparison["train"].get("noise_floor")
        found |= {name: comparison[name] for name in ("adequate", "p_value") if name in comparison}
    if diagnosis := summary.get("diagnosis"):
        found |= {"verdict": diagnosis["verdict"], "effects": ", ".join(diagnosis["effects"])}
    if steps := summary.get("improvement", {}).get("steps"):
        found |= {f"{name}_improved": steps[-1][name] for name in ("error_train", "error_test") if name in steps[-1]}
    if design := summary.get("design"):
        found["experiments"] = len(design["inputs"])
        if design["max_expected_improvement"]:
            found["max_expected_improvement"] = design["max_expected_improvement"][-1]
    return found


def is_grid(table: pd.DataFrame, keys: tuple[str, ...]) -> bool:
    """Whether the points are all combinations of the values of their keys."""
    return math.prod(table.loc[:, key].nunique(dropna=False) for key in keys) == len(table)


def dataset_of(table: pd.DataFrame, keys: tuple[str, ...]) -> xr.Dataset:
    """The table with a dimension per swept key where the points are a grid, else with the dimension `number`."""
    # A file of arrays knows neither a missing word nor a missing truth.
    plain = table.copy()
    for name in plain.columns.difference(list(keys)):
        if plain[name].dtype == "boolean":
            plain[name] = plain[name].astype(float)
        elif plain[name].dtype == object or pd.api.types.is_string_dtype(plain[name]):
            plain[name] = plain[name].fillna("").astype(object)
    if not is_grid(table, keys):
        return plain.to_xarray()
    plain["number"] = plain.index
    return plain.set_index(list(keys)).to_xarray()


def failures(path: Path, plan: Plan) -> Iterator[tuple[int, str, str]]:
    """Number (from 1), fault in one line, and traceback of every study that failed."""
    for number, ended in enumerate(outcomes(path, len(plan.points))):
        if ended["status"] == "failed":
            yield number + 1, f"{described(plan.points[number])}: {ended['message']}", ended["traceback"]


def _scalar(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, dict | list) else value
