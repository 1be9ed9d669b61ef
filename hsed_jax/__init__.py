"""Plan experiments, calibrate a structural model against them, find the physical effect it lacks."""

from __future__ import annotations

from importlib import import_module

# Not imported from `typing`, because every command would wait for it before it can answer a Ctrl-C.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from hsed_jax import plot as plot
    from hsed_jax.analysis.calibration import calibrate as calibrate
    from hsed_jax.analysis.calibration import campaign_of as campaign_of
    from hsed_jax.analysis.calibration import compare as compare
    from hsed_jax.analysis.calibration import locate as locate
    from hsed_jax.analysis.calibration import simulate as simulate
    from hsed_jax.analysis.discovery import discover as discover
    from hsed_jax.analysis.first_study import initial_study as initial_study
    from hsed_jax.analysis.listing import effects as effects
    from hsed_jax.analysis.remainder import learn_remainder as learn_remainder
    from hsed_jax.analysis.remedy import diagnose as diagnose
    from hsed_jax.analysis.remedy import improve as improve
    from hsed_jax.analysis.sensitivity import sensitivity as sensitivity
    from hsed_jax.config.load import load_study as load_study
    from hsed_jax.config.schema import Study as Study
    from hsed_jax.errors import UserError as UserError
    from hsed_jax.exports.designsafe import write_designsafe as write_designsafe
    from hsed_jax.exports.export import export as export
    from hsed_jax.intake.beginning import read_files as read_files
    from hsed_jax.measurements import Campaign as Campaign
    from hsed_jax.measurements import Experiment as Experiment
    from hsed_jax.measurements import Record as Record
    from hsed_jax.measurements import backbone_of as backbone_of
    from hsed_jax.measurements import backbone_table as backbone_table
    from hsed_jax.measurements import check_campaign as check_campaign
    from hsed_jax.measurements import cycle_table as cycle_table
    from hsed_jax.measurements import cycles_of as cycles_of
    from hsed_jax.measurements import read_at2 as read_at2
    from hsed_jax.measurements import read_campaign as read_campaign
    from hsed_jax.measurements import write_campaign as write_campaign
    from hsed_jax.physics.protocols import protocol_history as protocol_history
    from hsed_jax.registry import register as register
    from hsed_jax.runs.ask_tell import AskTell as AskTell
    from hsed_jax.runs.projects import read_designsafe as read_designsafe
    from hsed_jax.runs.reading import read_run as read_run
    from hsed_jax.runs.workflow import run as run
    from hsed_jax.sweeps.laws import laws as laws
    from hsed_jax.sweeps.sweep import sweep as sweep

# Public names by the module they live in, imported when first used: `hsed --help` answers before JAX is loaded.
_HOMES = {
    "analysis.calibration": ("calibrate", "campaign_of", "compare", "locate", "simulate"),
    "intake.beginning": ("read_files",),
    "physics.protocols": ("protocol_history",),
    "registry": ("register",),
    "runs.ask_tell": ("AskTell",),
    "config.load": ("load_study",),
    "config.schema": ("Study",),
    "errors": ("UserError",),
    "exports.designsafe": ("write_designsafe",),
    "exports.export": ("export",),
    "measurements": (
        "Campaign",
        "Experiment",
        "Record",
        "backbone_of",
        "backbone_table",
        "check_campaign",
        "cycle_table",
        "cycles_of",
        "read_at2",
        "read_campaign",
        "write_campaign",
    ),
    "analysis.discovery": ("discover",),
    "analysis.first_study": ("initial_study",),
    "analysis.listing": ("effects",),
    "analysis.remainder": ("learn_remainder",),
    "analysis.remedy": ("diagnose", "improve"),
    "analysis.sensitivity": ("sensitivity",),
    "sweeps.laws": ("laws",),
    "sweeps.sweep": ("sweep",),
    "runs.projects": ("read_designsafe",),
    "runs.reading": ("read_run",),
    "runs.workflow": ("run",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "plot":
        return import_module(f"{__name__}.plot")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*_HOME, "plot"])
