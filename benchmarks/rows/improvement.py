"""From a campaign to its report, as a user starts it, the campaign virtual or measured; and the improved model by NUTS."""

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from fresh import HSED, alone, soonest, taken, write_byte_code
from measure import line

_STUDY = Path(__file__).resolve().parents[2] / "configs" / "hidden_effect.yaml"
_HIDDEN = "stiffness_degradation"
_SIMULATIONS = 1_000_000
_STATES = ("compilation cache empty", "new process, cache filled")
# The loop's shape, too, so that there are four parameters; with `n` as well, beta and it can stand for one another.
_FREE = ("model.parameters.gamma={uniform: [-0.5, 0.5]}",)


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row: wall seconds on all cores."""
    settings = ("calibration={chains: 1, warmup: 20, draws: 20, starts: 2}",) if quick else ()
    write_byte_code()
    lines = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        measured, structure = _measured(folder)
        for what, study in (("virtual", (str(_STUDY),)), ("measured", (measured, structure))):
            lines += _started(folder / what, what, (*study, *settings))
        wall, cpu = soonest(folder / "cache", *HSED, "check", measured, structure)
        cost = {"imports of JAX and Equinox": soonest(folder / "cache", "-c", "import equinox, jax")[0]}
        lines.append(
            line("improvement", "hsed check of the measured campaign", "s", wall, cost, {"ours": {"CPU s": cpu}})
        )
        lines += _by_nuts(folder, folder / "virtual" / "improved.yaml", settings)
    # Not before: this process only starts others until now.
    from peers import native

    each = native.each()
    if each is None:
        return [{**entry, "notes": [native.NOTE]} for entry in lines]
    return [_beside_c(entry, _SIMULATIONS * each) for entry in lines]


def _beside_c(entry: dict[str, Any], cost: float) -> dict[str, Any]:
    peers = {**entry["peers"], f"{_SIMULATIONS} simulations in C on one core": cost}
    return line(entry["row"], entry["work"], entry["unit"], entry["ours"], peers, entry["accuracy"])


def _measured(folder: Path) -> tuple[str, str]:
    """A ready study for the campaign as if it had been measured, and the structure, which no measurement tells."""
    alone(performed, folder / "campaign")
    taken(folder / "cache", *HSED, "init", str(folder / "campaign"))
    structure = yaml.safe_load(_STUDY.read_text(encoding="utf-8"))["structure"]
    return str(folder / "campaign" / "study.yaml"), f"structure={json.dumps(structure)}"


def performed(folder: Path) -> None:
    """Write the campaign that the study's virtual laboratory measures."""
    import hsed_jax as hx
    from hsed_jax.analysis.calibration import campaign_of
    from hsed_jax.measurements import write_campaign

    write_campaign(campaign_of(hx.load_study(_STUDY)), folder)


def _started(output: Path, what: str, study: tuple[str, ...]) -> list[dict[str, Any]]:
    """The command, its figures and its report included."""
    lines = []
    for state in _STATES:
        wall, cpu = taken(output.with_suffix(".cache"), *HSED, "run", *study, "--output", str(output), "--force")
        summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
        assert (output / "report.html").exists()
        figures = {"CPU s": cpu, "effect not named": int(_HIDDEN not in summary["diagnosis"]["effects"])}
        work = f"hsed run of a {what} campaign, calibrate to report, {state}"
        cold = {"cold": lines[0]["ours"]} if lines else {}
        lines.append(line("improvement", work, "s", wall, cold, {"ours": figures}))
    return lines


def _by_nuts(folder: Path, improved: Path, settings: tuple[str, ...]) -> list[dict[str, Any]]:
    """The posterior of the improved model."""
    settings = (*_FREE, *settings, "calibration.sampler=nuts")
    found = [alone(calibrated, improved, settings, cache=folder / "nuts") for _ in _STATES]
    return [
        line(
            "improvement",
            f"posterior of the improved model by NUTS, {one['parameters']} parameters, {state}",
            "s",
            one["seconds"],
            {},
            {"ours": {"CPU s": one["CPU s"], "effective samples": one["effective samples"]}},
        )
        for state, one in zip(_STATES, found, strict=True)
    ]


def calibrated(study: Path, settings: tuple[str, ...]) -> dict[str, Any]:
    """What the calibration of a study took [s], and what its draws are worth."""
    import hsed_jax as hx
    from hsed_jax.analysis.calibration import campaign_of

    loaded = hx.load_study(study, settings)
    campaign = campaign_of(loaded)
    begin, spent = time.perf_counter(), time.process_time()
    found = hx.calibrate(loaded, campaign)
    return {
        "seconds": time.perf_counter() - begin,
        "CPU s": time.process_time() - spent,
        "parameters": len(found.fit.names),
        "effective samples": float(np.min(np.asarray(found.fit.convergence.ess_bulk))),
    }
