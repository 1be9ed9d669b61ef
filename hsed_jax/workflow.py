"""Running a study: its steps in order, with files, progress and resume around the pure pieces."""

import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from hsed_jax.config.build import Built
from hsed_jax.config.schema import Study
from hsed_jax.design.sequential import DesignState
from hsed_jax.errors import UserError
from hsed_jax.inference.fit import Fit, fit, summarise
from hsed_jax.inference.nuts import Settings
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, write_campaign, write_experiment
from hsed_jax.physics.outputs import output
from hsed_jax.reporting.outcome import Outcome, summary
from hsed_jax.store import RunFolder

# Keys of the random numbers: of the design's step i it is fold_in(root, i); the final calibration has its own.
_CALIBRATION = 1_000_000


class Interrupted(Exception):
    """The run stopped part-way and can be resumed; the message says where."""


class Run:
    """A study being run in a folder.

    Arguments:
        study: what to run.
        folder: of the study file, which its relative paths start from.
        output: the run folder.
        resume, force: what to do about a run that is there already.
        progress: show a progress bar.
    """

    def __init__(
        self,
        study: Study,
        folder: Path,
        output: str | Path,
        *,
        resume: bool = False,
        force: bool = False,
        progress: bool = True,
    ):
        self.study = study
        self.built = Built(study, folder)
        self.built.check()
        self.store = RunFolder(output, study.written(), resume=resume, force=force)
        self.progress = progress
        self.state: DesignState | None = None
        self.fit: Fit | None = None
        self.steps: list[dict[str, Any]] = []
        self.stop_reason = "iterations"
        self.campaign = self._empty_campaign()

    def __call__(self) -> dict[str, Any]:
        """Run the steps of the study; returns the content of `summary.json`.

        Raises:
            Interrupted: the user stopped it.
        """
        from hsed_jax.reporting.results import results_tree
        from hsed_jax.reporting.run_figures import draw

        try:
            for step in self.study.steps:
                getattr(self, f"_{step}")()
            outcome = self.outcome("complete")
            self.store.write_results(results_tree(outcome))
            self.store.write_summary(summary(outcome))
            draw(outcome, self.store.figures)
            self.store.finish()
            return summary(outcome)
        except KeyboardInterrupt:
            self.store.write_summary(summary(self.outcome("interrupted")))
            raise Interrupted(
                f"stopped after {len(self.steps)} of {self.study.design.iterations} steps of the design; "
                f"nothing is lost: say --resume to go on"
            ) from None
        finally:
            self.store.close()

    # The design: Steps 1 to 8 of the paper.

    def _design(self) -> None:
        design, entry = self.built.design, self.study.design
        self.state = design.init()
        planned = self._replay()
        root = jax.random.key(self.study.seed)
        initial = design.space.initial_design(entry.initial)
        for number in range(self.state.count, entry.initial):
            self._perform(number, initial[number])
        bar = tqdm(total=entry.iterations, initial=len(self.steps), disable=not self.progress, unit="step", desc="design")
        with bar:
            while len(self.steps) < entry.iterations and not self._finished():
                if planned is None:
                    planned = self._step(root)
                    bar.set_postfix_str(self._postfix())
                self._perform(self.state.count, planned)
                planned = None
                bar.update()
                if self._finished():
                    self.stop_reason = "tolerance"

    def _step(self, root) -> np.ndarray:
        assert self.state is not None
        number = len(self.steps)
        begin = time.perf_counter()
        chosen, self.state, info = self.built.design.ask(self.state, jax.random.fold_in(root, number))
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
        assert self.state is not None
        design = self.built.design
        declared = design.space.declared(np.asarray(cube)[None])
        inputs = dict(zip(design.space.names, declared[0].tolist(), strict=True))
        name = f"E{number + 1:02d}"
        self.store.record("asked", experiment=name, inputs=inputs, cube=np.asarray(cube).tolist())
        try:
            measured = self.built.laboratory.perform(number, {k: float(v[0]) for k, v in design.space.si(declared).items()})
            event = {"experiment": name, "quantities": measured.quantities}
            self.store.record("performed", **event, cube=np.asarray(cube).tolist(), inputs=inputs)
            self._take(name, np.asarray(cube), inputs, measured.quantities, None)
        except ExperimentFailed as failure:
            self.store.record("failed", experiment=name, cube=np.asarray(cube).tolist(), inputs=inputs, reason=str(failure))
            self._take(name, np.asarray(cube), inputs, {}, str(failure))
        write_experiment(self.campaign, name, self.store.campaign)

    def _take(
        self, name: str, cube: np.ndarray, inputs: dict[str, float], quantities: dict[str, float], failure: str | None
    ) -> None:
        assert self.state is not None
        outputs = [quantities.get(q, np.nan) for q in self.study.quantities]
        self.state = self.built.design.tell(self.state, cube.tolist(), outputs)
        si = {k: v * self.built.space.factors[k] for k, v in inputs.items()}
        status = "completed" if failure is None else "failed"
        self.campaign = self.campaign.add(Experiment(name, si, quantities=quantities, status=status, reason=failure))

    def _replay(self) -> np.ndarray | None:
        """Go through the journal; returns an input that was chosen and not yet performed."""
        assert self.state is not None
        planned = None
        for event in self.store.events():
            if event["event"] == "step":
                self.steps.append({k: v for k, v in event.items() if k != "event"})
                carried = event["state"]
                s = self.state
                theta = np.asarray(carried["theta"])
                self.state = DesignState(s.cube, s.conditions, s.outputs, s.count, theta, carried["step_size"])
                planned = np.asarray(event["cube"])
            elif event["event"] in ("performed", "failed"):
                found = event.get("quantities", {})
                self._take(event["experiment"], np.asarray(event["cube"]), event["inputs"], found, event.get("reason"))
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

    # The calibration on all that has been measured.

    def _calibrate(self) -> None:
        sizes = self.study.calibration
        if self.state is None:
            raise UserError("steps: calibrate needs experiments; put design before it")
        self.fit = fit(
            self.built.posterior,
            self.built.design.data(self.state),
            starts=sizes.starts,
            settings=Settings(sizes.chains, sizes.warmup, sizes.draws, sizes.target_acceptance),
            key=jax.random.fold_in(jax.random.key(self.study.seed), _CALIBRATION),
            units=self.built.units,
        )

    # What is left in the folder.

    def outcome(self, status: str) -> Outcome:
        """What the run has come to."""
        built = self.built
        return Outcome(
            self.study.study,
            status,
            built.posterior,
            built.simulator,
            built.laboratory,
            built.units,
            built.design,
            self.study.design.initial,
            self.state,
            self.steps,
            self.stop_reason if status == "complete" else status,
            self.fit,
        )

    def _empty_campaign(self) -> Campaign:
        declared = self.built.laboratory.noise
        channels = {}
        for name in self.study.quantities:
            noise = declared.get(name)
            of_channel = None
            if noise is not None:
                of_channel = Noise(relative=noise.size) if noise.relative else Noise(absolute=noise.size)
            channels[name] = Channel(name, output(name).unit, noise=of_channel)
        units = dict(self.built.space.units)
        return Campaign(self.study.study, "ground_motion", inputs=units, quantities=channels)
