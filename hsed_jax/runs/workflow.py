"""The run of a study: its steps in order, with files, progress and resume around the pure parts."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import Any

from tqdm import tqdm

from hsed_jax.analysis.calibration import Calibration, calibrate_built, compare, locate
from hsed_jax.analysis.discovery import discover
from hsed_jax.analysis.remainder import WithRemainder, has_remainder, learn_remainder
from hsed_jax.analysis.remedy import Improvement, diagnose, improve
from hsed_jax.config.schema import Study
from hsed_jax.criticism import locate as locating
from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.improve import Trail, step_of
from hsed_jax.criticism.locate import Location
from hsed_jax.design.drift import Drift
from hsed_jax.design.teaching import told
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.discovery.findings import Discovery
from hsed_jax.errors import UserError
from hsed_jax.interruptions import Interrupted, answered_by
from hsed_jax.laboratories.base import Awaited, ExperimentFailed, Measured
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.left_out import LeftOut
from hsed_jax.measurements import Campaign, backbone_table, cycle_table, stop_at_errors, write_campaign
from hsed_jax.physics.scales import Scales
from hsed_jax.runs.conduct import Asked, Conduct
from hsed_jax.runs.folder import RunFolder, laboratory_folder
from hsed_jax.runs.outcome import Outcome, summary
from hsed_jax.runs.progress import Progress
from hsed_jax.runs.reading import read_run
from hsed_jax.runs.requests import Requests
from hsed_jax.study.advice import forecast
from hsed_jax.study.build import Built
from hsed_jax.study.specimens import effects_of

_REPORTING = ("altair", "hsed_jax.reporting.report", "hsed_jax.runs.figures", "dask.array", "distributed")
"""Modules that a run needs at its end, the last two for the results.  They take seconds to load."""


class Waiting(Interrupted):
    """The run waits for an experiment that is performed by hand."""


def run(
    study: Study,
    output: str | Path | None = None,
    *,
    resume: bool = False,
    force: bool = False,
    progress: bool = True,
    figures: bool = True,
    laboratory: Callable[..., Any] | None = None,
    tell: Callable[..., None] | None = None,
) -> "Run":
    """Run the steps of a study, as the command line does.

    Arguments:
        study: the study to run.
        output: the run folder; by default `runs/<study>`.
        resume: continue the run in the folder.
        force: replace the run in the folder.
        progress: show a progress bar.
        figures: draw the figures and write `report.html`; without, a small study takes half the time.
        laboratory: the function that performs an experiment, of a study whose `experiments.python` names no file.
        tell: called with the run and the name of a step at the end of the step, and with `data` before the experiments are
            used.

    Raises:
        UserError: the study or the folder is wrong.
        Interrupted: the user stopped it, or it waits for an experiment; it can be resumed.
    """
    output = Path(output) if output else Path("runs") / study.study
    started = Run(study, output, resume=resume, force=force, progress=progress, laboratory=laboratory)
    started.figures = figures
    started.tell = tell or started.tell
    started()
    return started


class Run:
    """A study being run in a folder; see `run`.

    Attributes:
        conduct: of the design, where it ran.
        calibration, comparison, location, diagnosis, remaining, discovery, improvement, improved_location, remainder: results
            of the steps that ran.
        left_out: sentences on the figures and tables that could not be made.
    """

    def __init__(
        self,
        study: Study,
        output: Path,
        *,
        resume: bool,
        force: bool,
        progress: bool,
        laboratory: Callable[..., Any] | None = None,
    ):
        self.study = study
        self.built = Built(study, workspace=laboratory_folder(output), function=laboratory)
        measured = self.built.experiments.measured
        if measured is not None:
            stop_at_errors(measured, study.measurements.accepted(measured), study.needs_loops)
        self.built.check()
        if measured is not None and progress:
            print(forecast(self.built.inference, measured), flush=True)
        self.store = RunFolder(output, study.written(), resume=resume, force=force)
        self.progress = progress
        self.figures = True
        self.tell: Callable[..., None] = lambda run, step: None
        self.conduct: Conduct | None = None
        self._campaign = self.built.site.empty_campaign() if measured is None else measured
        self.stop_reason = "iterations"
        self.drift: Drift | None = None
        self._under_way = ""
        self._followed: Progress | None = None
        self.left_out: list[str] = []
        self.calibration: Calibration | None = None
        self.comparison: Comparison | None = None
        self.location: Location | None = None
        self.diagnosis: Diagnosis | None = None
        self.remaining: Location | None = None
        self.discovery: Discovery | None = None
        self.improvement: Improvement | None = None
        self.improved_location: Location | None = None
        self.trail: Trail | None = None
        self.remainder: WithRemainder | None = None

    @property
    def campaign(self) -> Campaign:
        """The experiments so far."""
        return self._campaign if self.conduct is None else self.conduct.campaign

    @property
    def steps(self) -> list[dict[str, Any]]:
        """The results of each step of the design, as in the journal."""
        return [] if self.conduct is None else self.conduct.steps

    def __call__(self) -> dict[str, Any]:
        """Run the steps; returns the content of `summary.json`."""
        if self.figures:
            Thread(target=_load_reporting, daemon=True).start()
        try:
            with answered_by(self._stopped):
                for step in self.study.steps:
                    self._under_way = step
                    getattr(self, f"_{step}")()
                    self.tell(self, step)
                self._under_way = "report"
                outcome = self.outcome("complete")
                content = summary(outcome)
                self.store.write_summary(content)
                self._write(outcome, content)
                return content
        except Waiting:
            self.store.write_summary(summary(self.outcome("waiting")))
            raise
        finally:
            self.store.close()

    def _write(self, outcome: Outcome, content: dict[str, Any]) -> None:
        """Write the results, draw the figures, and make a report of both; a figure that fails is left out with a message."""
        from hsed_jax.runs.results import results_tree

        if (cycles := cycle_table(outcome.campaign)).rows:
            self.store.write_cycles(cycles.csv(), backbone_table(outcome.campaign).csv())
        if not self.figures:
            self.store.write_results(results_tree(outcome, {}))
            self.store.finish()
            return
        from hsed_jax.reporting.report import report_page
        from hsed_jax.reporting.saving import Writer
        from hsed_jax.runs.figures import draw
        from hsed_jax.runs.illustrations import illustrations

        left_out = LeftOut()
        with Writer() as writer, self._watch("figures") as watch:
            tables = {}
            try:
                tables = illustrations(outcome, left_out, watch.report)
            finally:
                # Before the figures are drawn, so that the results are on the disk if a figure fails.
                self.store.write_results(results := results_tree(outcome, tables))
            draw(outcome, tables, self.store.figures, writer, left_out, watch.report)
        if left_out.reasons:
            content["left_out"] = left_out.sentences
            self.store.write_summary(content)
        self.store.finish()
        of_page = LeftOut()
        self.store.write_report(report_page(read_run(self.store.path, results), of_page))
        self.left_out = [*left_out.sentences, *of_page.sentences]

    def _stopped(self) -> str:
        """Write the results of an interrupted run, and report the position of the interruption."""
        content = summary(self.outcome("interrupted"))
        if self._leading:
            content["diagnosis"] = self._leading
        self.store.write_summary(content)
        steps = self.study.steps
        if self._under_way == "design":
            where = f"after {len(self.steps)} of {self.study.design.iterations} steps of the design"
        elif self._under_way in steps:
            where = f"while it was at {self._under_way}, {steps.index(self._under_way) + 1} of {len(steps)} steps"
        else:
            where = "while the results were written"
        return f"stopped {where}; nothing is lost: say --resume to go on"

    @property
    def _leading(self) -> dict[str, Any]:
        """The best result of an unfinished diagnosis."""
        return {} if self.diagnosis is not None or self._followed is None else self._followed.leading

    def _watch(self, step: str) -> Progress:
        return Progress(step, self.progress, self.store)

    def outcome(self, status: str) -> Outcome:
        """The outcome of the run so far."""
        laboratory = None if self.study.experiments.laboratory is None else self.built.site.laboratory
        return Outcome(
            study=self.study.study,
            status=status,
            posterior=self.built.inference.posterior,
            model=self.built.simulation.simulator,
            catalogue=(
                self.built if self.improvement is None else self.improvement.calibration.built
            ).mechanics.catalogue,
            laboratory=laboratory if isinstance(laboratory, VirtualLaboratory) else None,
            units=self.built.mechanics.units,
            campaign=self.campaign,
            space=self.built.experiments.space,
            design=None if self.conduct is None else self.conduct.design,
            initial=self.study.design.initial,
            state=None if self.conduct is None else self.conduct.state,
            steps=self.steps,
            stop_reason=self.stop_reason if status == "complete" else status,
            drift=self.drift,
            fit=None if self.calibration is None else self.calibration.fit,
            comparison=self.comparison,
            location=self.location,
            diagnosis=self.diagnosis,
            remaining=self.remaining,
            discovery=self.discovery,
            trail=self.trail,
            improved=None if self.improvement is None else self.improvement.calibration.fit,
            improved_comparison=None if self.improvement is None else self.improvement.after,
            improved_location=self.improved_location,
            remainder=self.remainder,
            scales=self._scales,
        )

    @property
    def _scales(self) -> Scales | None:
        """Characteristic values of the improved model, of a diagnosis' candidates, or of the model; None without effects."""
        if self.improvement is not None:
            return self.improvement.calibration.built.simulation.scales
        if self.diagnosis is not None and self.diagnosis.ranking:
            return self.diagnosis.scales
        return self.built.simulation.scales if effects_of(self.study) else None

    # The design: Steps 1 to 8 of the paper.

    def _design(self) -> None:
        self.conduct = conduct = Conduct(self.built, self.store)
        for id in conduct.pending:  # asked, and killed before the answer
            self._perform(conduct.request(id))
        budget = self.study.design.iterations
        bar = tqdm(total=budget, initial=len(conduct.steps), disable=not self.progress, unit="step", desc="design")
        with bar:
            while True:
                before = len(conduct.steps)
                conduct.choose()
                if len(conduct.steps) > before:
                    bar.set_postfix_str(self._postfix())
                    bar.update()
                if conduct.stop_reason is not None:
                    break
                self._perform(conduct.ask())
        self.stop_reason = conduct.stop_reason
        if conduct.state.is_measured.any():
            self.drift = conduct.design.drift(conduct.state)

    def _perform(self, asked: Asked) -> None:
        assert self.conduct is not None
        try:
            measured = self.built.site.laboratory.perform(asked.number, asked.si)
        except ExperimentFailed as failure:
            self.conduct.give_up(asked.id, str(failure))
            return
        except Awaited:
            measured = self._answered(Requests(self.conduct), asked)
        self.conduct.tell(asked.id, measured)

    def _answered(self, requests: Requests, asked: Asked) -> Measured:
        """The measurements of an experiment that people perform.

        Raises:
            Waiting: nothing was, yet.
        """
        requests.write(asked)
        if (measured := requests.answered(asked)) is not None:
            return measured
        inputs = ", ".join(f"{n} {v:.4g} {self.built.experiments.space.units[n]}" for n, v in asked.inputs.items())
        raise Waiting(
            f"experiment {asked.id} is asked: {inputs}; its request is in {requests.folder(asked.id)}; put the measurements "
            "there and say --resume, or use hsed tell"
        )

    def _postfix(self) -> str:
        step = self.steps[-1]
        estimates = ", ".join(f"{name} {value:.4g}" for name, value in step["map"].items())
        return f"max EI {told([one['max_expected_improvement'] for one in self.steps])[-1]:.2e}, {estimates}"

    # The experiments as data.

    def _calibrate(self) -> None:
        if self.conduct is not None:
            # Padded as the design's own data are, so that its programs serve.
            size = self.conduct.design.size_of(self.conduct.state)
        else:
            if self.built.experiments.measured is None:
                self._campaign = self.built.site.perform()
            write_campaign(self.campaign, self.store.campaign)
            size = None
        self.tell(self, "data")
        with self._watch("calibrate") as watch:
            self.calibration = calibrate_built(self.built, self.campaign, size=size, watch=watch)

    def _compare(self) -> None:
        if self.calibration is None:
            raise UserError("steps: compare needs a calibrated model; put calibrate before it")
        self.comparison = compare(self.calibration)
        self.location = locate(self.calibration)

    # The missing effects, and the improvement by them.

    def _diagnose(self) -> None:
        assert self.calibration is not None
        with self._watch("diagnose") as watch:
            # The same object until the diagnosis is there.
            self._followed = watch
            self.diagnosis = diagnose(self.calibration, watch=watch)
        if self.diagnosis.effects:
            self.remaining = locating.locate(self.diagnosis.prediction, self.campaign)

    def _discover(self) -> None:
        assert self.calibration is not None
        with self._watch("discover") as watch:
            self.discovery = discover(self.calibration, diagnosis=self.diagnosis, watch=watch)
        if self.discovery.found:
            self.discovery.write(self.store.path / self.discovery.file)

    def _improve(self) -> None:
        last, compared = self.calibration, self.comparison
        assert last is not None
        assert compared is not None
        with self._watch("improve") as watch:
            if added := self._to_add():
                self.improvement = improve(last, watch=watch, **added)
                last, compared = self.improvement.calibration, self.improvement.after
                self.trail = self.improvement.trail
                self.improvement.write(self.store.improved)
                self.improved_location = locate(last)
            else:
                self.trail = Trail([step_of([], compared, last.map)], compared.train.noise_floor)
            if compared.test is not None and not compared.adequate and has_remainder(last):
                watch.report("what the model leaves")
                self.remainder = learn_remainder(last)

    def _to_add(self) -> dict[str, Any]:
        """The effects to add, as arguments of `improve`; empty without any."""
        diagnosis, discovery, chosen = self.diagnosis, self.discovery, self.study.improve.add
        if chosen:
            known = {} if diagnosis is None else {"forms": diagnosis.forms, "start": diagnosis.optimum}
            return {"effects": chosen, **known}
        if discovery is not None and discovery.found:
            files = [self.store.path / discovery.file]
            return {"effects": [*discovery.effects, discovery.effect], "forms": discovery.forms, "own_effects": files}
        return {"found": diagnosis} if diagnosis is not None and diagnosis.effects else {}


def _load_reporting() -> None:
    """Load what a run needs at its end, while its simulations leave Python idle."""
    for module in _REPORTING:
        import_module(module)
