"""The output of `hsed check` on a study and its data; no step of the study is run."""

import sys
from collections.abc import Sequence, Set
from pathlib import Path

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Finding, check_campaign, overview, read_campaign, stop_at_errors
from hsed_jax.reporting.doubt_figures import write_pictures
from hsed_jax.study.advice import forecast, frequency_doubts
from hsed_jax.study.build import Built
from hsed_jax.study.excitations import sentence_of
from hsed_jax.study.unit_doubts import unit_doubts


def check_study(study: Study, path: Path, *, predict: bool = False, worth: str | None = None) -> None:
    """Build a study, print the errors and doubts of the study and its data, and draw the doubted records.

    Arguments:
        study: of the user.
        path: its file; the pictures go into the folder `figures` beside it.
        predict: simulate the model all over its priors, and print which data they exclude.
        worth: folder of a campaign of earlier experiments; print their information about the planned experiments.

    Raises:
        UserError: the study cannot be run, the data have errors, or there is nothing measured to compare a prediction with.
    """
    built = Built(study)
    _ = built.mechanics.catalogue  # the study's own effects may have faults, so they come before the data
    measured = built.experiments.measured
    accepted = study.measurements.accepted(measured)
    # Before any computation from the data, because a time that is not a number has no steps.
    findings = [] if measured is None else check_campaign(measured)
    _tell(findings, accepted)
    if any(finding.level == "error" for finding in findings):
        raise UserError(f"{path}: the data have errors, listed above; nothing is repaired silently")
    built.check()
    further = unit_doubts(built)
    _tell(further, accepted)
    if measured is not None:
        _draw(measured, [*findings, *further], path.parent / "figures")
        print(overview(measured))
        for note in (*built.experiments.thinning_notes(measured), *frequency_doubts(built.mechanics, measured)):
            print(note)
        print(forecast(built.inference, measured))
        stop_at_errors(measured, accepted, study.needs_loops)
    if built.experiments.excitation is not None and built.simulation.grid is None:
        print(f"{sentence_of(study)}; {built.simulation.planned.steps} steps of the integration")
    if predict:
        if measured is None:
            raise UserError("--predict compares predictions with measurements; give experiments.campaign")
        # A check without it does not sample, and does not load the samplers.
        from hsed_jax.analysis.prior_prediction import prior_sentences

        for sentence in prior_sentences(built.inference, measured):
            print(f"prior prediction: {sentence}")
    if worth is not None:
        from hsed_jax.analysis.prior_worth import worth_of

        print(worth_of(built.inference, read_campaign(worth)))
    if "diagnose" in study.steps:
        for note in built.mechanics.naming.left_out():
            print(f"diagnose: {note}")
    print(f"{path}: the study is valid; its steps are {', '.join(study.steps)}")


def _tell(findings: Sequence[Finding], accepted: Set[tuple[str, str]]) -> None:
    """Print the findings, and those that the study accepts."""
    for finding in findings:
        print(f"{finding.line} (accepted)" if (finding.experiment, finding.kind) in accepted else finding)


def _draw(campaign: Campaign, findings: Sequence[Finding], folder: Path) -> None:
    """Write pictures of the doubted records and print their names; a folder that cannot be written is not an error of
    the data.
    """
    try:
        for id, file in write_pictures(campaign, findings, folder):
            print(f"{id}: the picture {file} marks the doubtful samples")
    except UserError as error:
        print(f"warning: {error}", file=sys.stderr)
