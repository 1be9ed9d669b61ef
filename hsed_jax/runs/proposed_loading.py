"""The loading that a diagnosis proposes, as the command of a test: a file that a controller reads.

A diagnosis of a component test that ends `ambiguous` proposes reversals of a new test (`hsed_jax.diagnosis.loadings`).  The
command moves between them at the proposed rate.
"""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
from jaxtyping import Float

from hsed_jax.config.load import load_study
from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.measurements import parse_unit, read_campaign
from hsed_jax.runs.reading import mapping

FILE = "next_loading.csv"
# Rows between two reversals.
_EACH = 40


def has_no_design(study: str | Path) -> bool:
    """Whether a path is the folder of a run whose study has no step `design`, so that a diagnosis asks for its next test."""
    file = Path(study) / "study.yaml"
    return file.is_file() and "design" not in load_study(file).steps


def ask_loading(run: str | Path) -> str:
    """Write the proposed loading into the folder of a run, as `next_loading.csv`, and describe it.

    The columns have the names and units of the measured ones: time, where the rate is known, and elongation.

    Raises:
        UserError: the run has no results, or its diagnosis proposes no loading.
    """
    folder = Path(run)
    found: Mapping[str, Any] = mapping(folder / "summary.json", "study", "status").get("diagnosis", {})
    loading = found.get("next_loading")
    if loading is None:
        raise UserError(
            f"{folder}: there is no experiment to ask for: the study has no step design, and its diagnosis proposes no loading; "
            "it proposes one if its verdict on a component test is ambiguous and a test is expected to settle it"
        )
    declared = read_campaign(folder / "campaign").channels["elongation"].unit
    time, elongation = history([0.0, *loading["reversals"]], loading["rate"])
    shown = parse_unit(declared).from_si(elongation)
    columns = {f"elongation [{declared}]": shown}
    if time is not None:
        columns = {"time [s]": time, **columns}
    lines = [
        ",".join(columns),
        *(",".join(f"{value:.6g}" for value in row) for row in zip(*columns.values(), strict=True)),
    ]
    write_whole(folder / FILE, "\n".join(lines) + "\n")
    lasts = "" if time is None else f", {time[-1]:.4g} s"
    return "\n".join([
        f"a new specimen under {loading['name']}: {len(loading['reversals'])} reversals, at most "
        f"{np.abs(shown).max():.4g} {declared}{lasts}",
        f"  expected log Bayes factor between the explanations {loading['expected_log_bayes_factor']:.2g} nats; of the same test "
        f"again {loading['repeated']:.2g} nats",
        f"  command in {quote(str(folder / FILE))}",
        "  then: measure the force, and diagnose both tests together: hsed init FIRST.csv SECOND.csv",
    ])  # fmt: skip


def history(
    reversals: list[float], rate: float | None
) -> tuple[Float[np.ndarray, " n"] | None, Float[np.ndarray, " n"]]:
    """Time [s] and elongation of ramps of constant rate between reversals.

    Arguments:
        reversals: elongations in order, the first one where the test starts.
        rate: of the elongation, in its unit per second; None: there is no time.
    """
    ramps = [np.linspace(begin, end, _EACH, endpoint=False) for begin, end in pairwise(reversals)]
    elongation = np.concatenate([*ramps, reversals[-1:]])
    if rate is None:
        return None, elongation
    return np.cumsum(np.abs(np.diff(elongation, prepend=elongation[0]))) / rate, elongation
