"""Running a study: its steps in order, with files, progress and resume around the pure pieces."""

import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from hsed_jax.analysis import Calibration, calibrate_built, compare, locate, stop_at_errors
from hsed_jax.config.build import Built
from hsed_jax.config.schema import Study
from hsed_jax.criticism import locate as locating
from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.findings import Diagnosis
from hsed_jax.criticism.improve import Trail, step_of
from hsed_jax.criticism.locate import Location
from hsed_jax.design.sequential import DesignState
from hsed_jax.errors import UserError
from hsed_jax.inference.fit import summarise
from hsed_jax.laboratories.base import ExperimentFailed, Measured
from hsed_jax.measurements import (
    Experiment,
    read_campaign,
    write_campaign,
    write_experiment,
)
from hsed_jax.remedy import Improvement, diagnose, discriminate, improve
from hsed_jax.reporting.outcome import Outcome, summary
from hsed_jax.store import RunFolder, read_run


class Interrupted(Exception):
    """The run stopped part-way and can be resumed; the message says where."""


def run(
    study: Study,
    output: str | Path | None = None,
    *,
    resume: bool = False,
    force: bool = False,
    progress: bool = True,
) -> "Run":
    """Run the steps of a study, as the command line does.

    Arguments:
        study: what to run.
        output: the run folder; by default `runs/<study>`.
        resume: go on with the run in the folder.
        force: replace the run in the folder.
        progress: show a progress bar.

    Raises:
        UserError: the study or the folder is wrong.
        Interrupted: the user stopped it; it can be resumed.
    """
    started = Run(study, output or Path("runs") / study.study, resume=resume, force=force, progress=progress)
    started()
    return started


class Run:
    """A study being run in a folder; see `run`.

    Attributes:
        campaign: the experiments so far.
        steps: what each step of the design found, as in the journal.
        calibration, comparison, location, diagnosis, remaining, improvement: results of the steps that ran.
    """

    def __init__(self, study: Study, output: str | Path, *, resume: bool, force: bool, progress: bool):
        self.study = study
        self.built = Built(study)
        self.built.check()
        if self.built.measured is not None:
            stop_at_errors(self.built.measured)
        self.store = RunFolder(output, study.written(), resume=resume, force=force)
        self.progress = progress
        self.state: DesignState | None = None
        self.campaign = self.built.empty_campaign() if self.built.measured is None else self.built.measured
        self.steps: list[dict[str, Any]] = []
        self.stop_reason = "iterations"
        self.calibration: Calibration | None = None
        self.comparison: Comparison | None = None
        self.location: Location | None = None
        self.diagnosis: Diagnosis | None = None
        self.remaining: Location | None = None
        self.improvement: Improvement | None = None
        self.trail: Trail | None = None

    def __call__(self) -> dict[str, Any]:
        """Run the steps; returns the content of `summary.json`."""
        from hsed_jax.reporting.report import report_page
        from hsed_jax.reporting.results import results_tree
        from hsed_jax.reporting.run_figures import draw

        try:
            for step in self.study.steps:
                getattr(self, f"_{step}")()
            outcome = self.outcome("complete")
            self.store.write_results(results_tree(outcome))
            content = summary(outcome)
            self.store.write_summary(content)
            draw(outcome, self.store.figures)
            self.store.finish()
            self.store.write_report(report_page(read_run(self.store.path)))
            return content
        except KeyboardInterrupt:
            self.store.write_summary(summary(self.outcome("interrupted")))
            raise Interrupted(
                f"stopped after {len(self.steps)} of {self.study.design.iterations} steps of the design; "
                "nothing is lost: say --resume to go on"
            ) from None
        finally:
            self.store.close()

    def outcome(self, status: str) -> Outcome:
        """What the run has come to."""
        return Outcome(
            study=self.study.study,
            status=status,
            posterior=self.built.posterior,
            simulator=self.built.simulator,
            laboratory=self.built.laboratory if self.study.experiments.virtual is not None else None,
            units=self.built.units,
            campaign=self.campaign,
            space=self.built.space,
            design=self.built.design if self.state is not None else None,
            initial=self.study.design.initial,
            state=self.state,
            steps=self.steps,
            stop_reason=self.stop_reason if status == "complete" else status,
            fit=None if self.calibration is None else self.calibration.fit,
            comparison=self.comparison,
            location=self.location,
            diagnosis=self.diagnosis,
            remaining=self.remaining,
            trail=self.trail,
            improved=None if self.improvement is None else self.improvement.calibration.fit,
            improved_comparison=None if self.improvement is None else self.improvement.after,
        )

    # The design: Steps 1 to 8 of the paper.

    def _design(self) -> None:
        design, entry = self.built.design, self.study.design
        self.state = design.init()
        planned = self._replay()
        root = jax.random.key(self.study.seed)
        initial = design.space.initial_design(entry.initial)
        for number in range(self.state.count, entry.initial):
            self._perform(number, initial[number])
        bar = tqdm(
            total=entry.iterations, initial=len(self.steps), disable=not self.progress, unit="step", desc="design"
        )
        with bar:
            while planned is not None or (len(self.steps) < entry.iterations and not self._finished()):
                if planned is None:
                    planned = self._step(root)
                    bar.set_postfix_str(self._postfix())
                    bar.update()
                self._perform(self.state.count, planned)
                planned = None
        if self._finished():
            self.stop_reason = "tolerance"

    def _step(self, root) -> np.ndarray:
        assert self.state is not None
        number = len(self.steps)
        begin = time.perf_counter()
        by = None
        if self.study.design.acquisition == "discriminate":
            by = discriminate(self.built, self.campaign)
        chosen, self.state, info = self.built.design.ask(self.state, jax.random.fold_in(root, number), by)
        names = self.built.posterior.names
        step = {
            "number": number,
            "cube": chosen.tolist(),
            "max_expected_improvement": info.expected_improvement,
            "acquisition": info.value,
            "map": dict(zip(names, np.asarray(info.maximum.theta).tolist(), strict=True)),
            "posterior": summarise(names, info.chains, info.convergence),
            "divergences": info.convergence.divergences,
            "log_evidence": float(info.maximum.log_evidence),
            "discrepancy": info.discrepancy.tolist(),
            "kriging": {
                "lengths": np.asarray(info.kriging.lengths).tolist(),
                "nugget": float(info.kriging.nugget),
                "process_variance": float(info.kriging.process_variance),
            },
            "state": {"theta": np.asarray(info.maximum.u).tolist(), "step_size": self.state.step_size},
            "seconds": time.perf_counter() - begin,
        }
        self.store.record("step", **step)
        self.steps.append(step)
        return chosen

    def _perform(self, number: int, cube: np.ndarray) -> None:
        """Ask the laboratory for one experiment, and keep what comes before anything else happens."""
        space = self.built.space
        declared = space.declared(np.asarray(cube)[None])
        inputs = dict(zip(space.names, declared[0].tolist(), strict=True))
        name = f"E{number + 1:02d}"
        about: dict[str, Any] = {"experiment": name, "inputs": inputs, "cube": np.asarray(cube).tolist()}
        self.store.record("asked", **about)
        try:
            si = {k: float(v[0]) for k, v in space.si(declared).items()}
            measured = self.built.laboratory.perform(number, si)
        except ExperimentFailed as failure:
            self._take(about, Measured({}), str(failure))
            write_experiment(self.campaign, name, self.store.campaign)
            self.store.record("failed", **about, reason=str(failure))
            return
        self._take(about, measured, None)
        # The record is on the disk before the journal says that it is.
        write_experiment(self.campaign, name, self.store.campaign)
        self.store.record("performed", **about, quantities=measured.quantities)

    def _take(self, about: dict[str, Any], measured: Measured, failure: str | None) -> None:
        assert self.state is not None
        si = {name: value * self.built.space.factors[name] for name, value in about["inputs"].items()}
        experiment = Experiment(
            about["experiment"],
            si,
            record=measured.record,
            quantities=measured.quantities,
            status="completed" if failure is None else "failed",
            reason=failure,
        )
        self.campaign = self.campaign.add(experiment)
        outputs = np.full(self.built.observation.groups.size, np.nan)
        if failure is None:
            # As the campaign holds it: what is read back from its files is the same to the last bit.
            outputs = self.built.observation.measured(self.campaign[experiment.id])
        self.state = self.built.design.tell(self.state, about["cube"], outputs.tolist())

    def _replay(self) -> np.ndarray | None:
        """Go through the journal; returns an input that was chosen and not yet performed."""
        assert self.state is not None
        planned = None
        events = self.store.events()
        held = any(event["event"] == "performed" for event in events) and self.study.observe == "histories"
        records = read_campaign(self.store.campaign) if held else None
        for event in events:
            if event["event"] == "step":
                self.steps.append({k: v for k, v in event.items() if k != "event"})
                carried, s = event["state"], self.state
                theta = np.asarray(carried["theta"])
                self.state = DesignState(s.cube, s.conditions, s.outputs, s.count, theta, carried["step_size"])
                planned = np.asarray(event["cube"])
            elif event["event"] in ("performed", "failed"):
                record = records[event["experiment"]].record if records is not None else None
                self._take(event, Measured(event.get("quantities", {}), record), event.get("reason"))
                planned = None
        if len(self.campaign):
            write_campaign(self.campaign, self.store.campaign)
        return planned

    def _finished(self) -> bool:
        tolerance = self.study.design.tolerance
        return tolerance is not None and bool(self.steps) and self.steps[-1]["max_expected_improvement"] < tolerance

    def _postfix(self) -> str:
        step = self.steps[-1]
        estimates = ", ".join(f"{name} {value:.4g}" for name, value in step["map"].items())
        return f"max EI {step['max_expected_improvement']:.2e}, {estimates}"

    # What is made of the experiments.

    def _calibrate(self) -> None:
        if self.state is not None:
            design = self.built.design
            self.calibration = calibrate_built(self.built, self.campaign, design.data(self.state), design.maximise)
            return
        if self.built.measured is None:
            self.campaign = self.built.perform()
        write_campaign(self.campaign, self.store.campaign)
        self.calibration = calibrate_built(self.built, self.campaign)

    def _compare(self) -> None:
        if self.calibration is None:
            raise UserError("steps: compare needs a calibrated model; put calibrate before it")
        self.comparison = compare(self.calibration)
        self.location = locate(self.calibration)

    # What it lacks, and what adding that does.

    def _diagnose(self) -> None:
        assert self.calibration is not None
        with tqdm(disable=not self.progress, bar_format="diagnose: {desc} [{elapsed}]") as bar:
            self.diagnosis = diagnose(self.calibration, report=bar.set_description_str)
        if self.diagnosis.effects:
            self.remaining = locating.locate(self.diagnosis.prediction, self.campaign)

    def _improve(self) -> None:
        assert self.calibration is not None
        assert self.comparison is not None
        effects = self.study.improve.add or (self.diagnosis.effects if self.diagnosis is not None else [])
        if not effects:
            self.trail = Trail([step_of([], self.comparison, self.calibration.map)], self.comparison.train.noise_floor)
            return
        self.improvement = improve(self.calibration, effects=effects)
        self.trail = self.improvement.trail
        self.improvement.write(self.store.improved)
