"""The conduct of a design: requests, answers, and the journal of both.

The run's loop, `hsed ask` and `hsed tell` are three callers of one object.  Every event is on the disk before it is used. A
replay of the journal gives the same state to the last bit, in one process or in many.
"""

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from hsed_jax.analysis.remedy import separations, verdict_of
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.design.sequential import DesignState, Trial
from hsed_jax.design.space import Point
from hsed_jax.design.stopping import StopRules, stop_reason
from hsed_jax.errors import UserError
from hsed_jax.inference.nuts import summarise
from hsed_jax.laboratories.base import Measured, experiment_id
from hsed_jax.measurements import Campaign, Experiment, Record, read_campaign, write_campaign, write_experiment
from hsed_jax.runs.folder import RunFolder
from hsed_jax.study.build import Built

_DRAWS = 64
"""Draws of the parameters that are kept with each step; enough for bands."""
_STEP = ("cube", "max_expected_improvement", "acquisition", "map", "posterior", "draws", "divergences", "log_evidence",
         "discrepancy", "kriging", "state")  # fmt: skip
"""The entries of a step in the journal that further steps and the results need."""


class Asked(NamedTuple):
    """An experiment that is to be performed.

    Attributes:
        id, number: of the experiment; the number counts from 0.
        inputs: in declared units.
        si: the same in SI.
        attempt: at it, from 1.
    """

    id: str
    number: int
    attempt: int
    inputs: dict[str, float]
    si: dict[str, float]


class Conduct:
    """A design in progress.

    Arguments:
        built: the study.
        store: the run folder; its journal is replayed.

    Attributes:
        campaign: the experiments in the order of their requests or reports, pending ones included.
        state: of the design; its trials are the experiments of the campaign, in the same order.
        steps: results of each step of the design, as in the journal.
    """

    def __init__(self, built: Built, store: RunFolder):
        self.built, self.store, self.design = built, store, built.design.sequential
        self.state: DesignState = self.design.init()
        self.campaign = built.site.empty_campaign()
        self.steps: list[dict[str, Any]] = []
        self._attempts: Counter[str] = Counter()
        self._initial = self.design.space.initial_design(built.study.design.initial)
        self._chosen: np.ndarray | None = None
        self._replay()

    @property
    def pending(self) -> list[str]:
        """Requested experiments without a report."""
        return [e.id for e in self.campaign if e.status == "pending"]

    @property
    def most_out(self) -> int | None:
        """Largest number of pending experiments; None if the design can choose further ones."""
        left = len(self._initial) - len(self.campaign)
        can_choose = int(self.state.is_measured.sum()) >= self.design.least or not self.built.study.design.iterations
        return None if left <= 0 or can_choose else len(self.pending) + left

    @property
    def stop_reason(self) -> str | None:
        """The reason why the design is complete: `iterations` or the name of a stop rule; None while one is."""
        if not self._asked_initial:
            return None
        if self._chosen is None and len(self.steps) >= self.built.study.design.iterations:
            return "iterations"
        return stop_reason(StopRules(**self.built.study.design.stop.model_dump()), self.steps)

    @property
    def _asked_initial(self) -> bool:
        return len(self.campaign) >= len(self._initial)

    def ask(self) -> Asked:
        """The next experiment: of the initial design, or chosen by a step of the design.

        Raises:
            UserError: the design cannot continue: too few experiments have usable results, or no candidate is left.
        """
        number = len(self.campaign)
        if number < len(self._initial):
            cube = self._initial[number]
        else:
            cube = self._step() if self._chosen is None else self._chosen
        name = experiment_id(number)
        while name in self.campaign:
            name = f"{name}x"
        return self._ask(name, self.design.space.point(cube))

    def ask_again(self, id: str) -> Asked:
        """Request a failed experiment again.

        Raises:
            UserError: there is no such experiment, or it did not fail.
        """
        trial = self._trial(id)
        if trial.status != "failed":
            raise UserError(f"experiment {id} is {trial.status}; only one that failed is asked again")
        return self._ask(id, trial.point)

    def request(self, id: str) -> Asked:
        """A requested experiment.

        Raises:
            UserError: there is no such experiment.
        """
        point = self._trial(id).point
        return Asked(id, self._row(id), self._attempts[id], point.declared, point.si)

    def tell(self, id: str, measured: Measured, inputs: Mapping[str, float] | None = None) -> None:
        """Record the measurements of an experiment.

        Arguments:
            id: of the experiment; an unrequested one needs `inputs` and is welcome.
            measured: results of the laboratory.
            inputs: as tested, in declared units, if they differ from the requested ones.

        Raises:
            UserError: the experiment is unknown, already completed or abandoned, or the report does not fit the study.
        """
        point = self.settling(id, inputs)
        self._take(point, Experiment(id, point.si, record=measured.record, quantities=measured.quantities))
        # The record is on the disk before the journal names it.
        write_experiment(self.campaign, id, self.store.campaign)
        self.store.record("performed", **_about(id, point), quantities=measured.quantities)

    def give_up(
        self,
        id: str,
        reason: str,
        *,
        abandon: bool = False,
        record: Record | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> None:
        """Record a failed experiment (it may be requested again), or an abandoned one (it is never requested again).

        Arguments:
            id: of the experiment.
            reason: why.
            abandon: never to be asked again.
            record: measurements until then; kept, and not fitted.
            inputs: as tested, in declared units, if they differ from the requested ones.

        Raises:
            UserError: the experiment is unknown, or completed or abandoned already.
        """
        point, status = self.settling(id, inputs), "abandoned" if abandon else "failed"
        self._take(point, Experiment(id, point.si, record=record, status=status, reason=reason))
        write_experiment(self.campaign, id, self.store.campaign)
        self.store.record(status, **_about(id, point), reason=reason)

    # One step of the design.

    def _step(self) -> np.ndarray:
        study, number = self.built.study, len(self.steps)
        begin = time.perf_counter()
        acquisition: Any = ACQUISITIONS[study.design.acquisition]
        by = acquisition(separations(self.built, self.campaign)) if acquisition.of_rivals else None
        key = jax.random.fold_in(jax.random.key(study.seed), number)
        chosen, self.state, info = self.design.ask(self.state, key, by)
        names = self.built.inference.posterior.names
        draws = np.asarray(info.chains.theta).reshape(-1, len(names))
        step = {
            "number": number,
            "cube": chosen.tolist(),
            "max_expected_improvement": info.expected_improvement,
            "acquisition": info.value,
            "map": dict(zip(names, np.asarray(info.maximum.theta).tolist(), strict=True)),
            "posterior": summarise(names, info.chains, info.convergence),
            "draws": draws[:: max(1, len(draws) // _DRAWS)][:_DRAWS].tolist(),
            "divergences": info.convergence.divergences,
            "sampler": info.chains.sampler,
            "emulator_error": info.chains.emulator_error,
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
        if study.design.stop.verdict:
            step["verdict"] = verdict_of(self.built, self.campaign)
        self.store.record("step", **step)
        self.steps.append(step)
        self._chosen = chosen
        return chosen

    def choose(self) -> None:
        """Make the step of the design that chooses the next experiment, if it is due and not made yet."""
        if self._asked_initial and self._chosen is None and self.stop_reason is None:
            self._step()

    @property
    def draws(self) -> np.ndarray:
        """Draws of the parameters of the model, SI, (n, p): from the posterior of the last step, otherwise from the prior."""
        if self.steps:
            return np.asarray(self.steps[-1]["draws"])[:, : len(self.built.inference.posterior.model_names)]
        priors = self.built.mechanics.parameters[0].values()
        keys = jax.random.split(jax.random.key(self.built.study.seed), len(priors))
        return np.stack(
            [np.asarray(p.distribution.sample(k, (_DRAWS,))) for p, k in zip(priors, keys, strict=True)], axis=1
        )

    # The results of the experiments.

    def settling(self, id: str, inputs: Mapping[str, float] | None) -> Point:
        """The point of a reported experiment: as requested, or as tested.

        Raises:
            UserError: a report is not allowed, or its inputs are not those of the study.
        """
        if id in self.campaign and self._trial(id).status not in ("pending", "failed"):
            raise UserError(f"experiment {id} is {self._trial(id).status} already")
        if inputs is not None:
            try:
                return self.design.space.located(inputs)
            except UserError as error:
                raise UserError(f"experiment {id}: {error}") from None
        if id not in self.campaign:
            raise UserError(
                f"experiment {id!r} was not asked; give its inputs ({', '.join(self.design.space.names)}), or name one "
                f"of: {', '.join(self.pending) or 'none is pending'}"
            )
        return self._trial(id).point

    def _row(self, id: str) -> int:
        known = [experiment.id for experiment in self.campaign]
        if id not in known:
            raise UserError(f"there is no experiment {id!r}; there are {', '.join(known) or 'none'}")
        return known.index(id)

    def _trial(self, id: str) -> Trial:
        return self.state.trials[self._row(id)]

    def _ask(self, id: str, point: Point) -> Asked:
        self.store.record("asked", **_about(id, point))
        self._expect(id, point)
        return self.request(id)

    def _expect(self, id: str, point: Point) -> None:
        """Count an experiment as requested."""
        self._take(point, Experiment(id, point.si, status="pending"))
        self._attempts[id] += 1
        self._chosen = None

    def _take(self, point: Point, experiment: Experiment) -> None:
        row = self._row(experiment.id) if experiment.id in self.campaign else len(self.campaign)
        is_new = row == len(self.campaign)
        self.campaign = self.campaign.add(experiment) if is_new else self.campaign.update(experiment)
        outputs = np.full(self.built.inference.observation.groups.size, np.nan)
        if experiment.status == "completed":
            # As in the campaign, whose files give the same numbers to the last bit.
            outputs = self.built.inference.observation.measured(self.campaign[experiment.id])
            if not np.isfinite(outputs).any():
                raise UserError(f"experiment {experiment.id}: nothing that the study observes was measured")
        self.state = self.design.tell(self.state, point.cube.tolist(), outputs.tolist(), experiment.status, row)

    def _replay(self) -> None:
        """Replay the journal.

        Raises:
            UserError: it is damaged, or lacks experiments that would be performed again.
        """
        events = self.store.events()
        is_kept = (self.store.campaign / "campaign.yaml").exists()
        if is_kept and not events:
            raise self.store.damaged("it is empty or gone, and the experiments of the run would be performed again")
        performed = {event.get("experiment") for event in events if event["event"] == "performed"}
        records = read_campaign(self.store.campaign) if is_kept and performed else None
        # A killed process loses the line of one experiment at most, which is then performed again.
        lost = [] if records is None else [e.id for e in records if e.status == "completed" and e.id not in performed]
        if len(lost) > 1:
            raise self.store.damaged(f"it does not know {', '.join(lost)}, which would be performed again")
        for number, event in enumerate(events, start=1):
            try:
                self._take_up(event, records)
            except (AttributeError, KeyError, TypeError, ValueError, IndexError) as error:
                raise self.store.damaged(
                    f"line {number} is not a complete event ({type(error).__name__}: {error})"
                ) from None
        if len(self.campaign):
            write_campaign(self.campaign, self.store.campaign)

    def _take_up(self, event: dict[str, Any], records: Campaign | None) -> None:
        """Apply one event of the journal."""
        kind = event["event"]
        if kind == "step":
            for key in _STEP:
                _ = event[key]
            carried = event["state"]
            self.steps.append({k: v for k, v in event.items() if k != "event"})
            self.state = replace(self.state, theta=np.asarray(carried["theta"]), step_size=carried["step_size"])
            self._chosen = np.asarray(event["cube"])
        elif kind == "asked":
            self._expect(event["experiment"], self.design.space.point(np.asarray(event["cube"])))
        elif kind in ("performed", "failed", "abandoned"):
            name, space = event["experiment"], self.design.space
            self._take(
                space.point(np.asarray(event["cube"])),
                Experiment(
                    name,
                    {key: value * space.factors[key] for key, value in event["inputs"].items()},
                    record=records[name].record if records is not None and name in records else None,
                    quantities=event.get("quantities", {}),
                    status="completed" if kind == "performed" else kind,
                    reason=event.get("reason"),
                ),
            )
        else:
            raise ValueError("there is no such event")


def _about(id: str, point: Point) -> dict[str, Any]:
    """An entry of an experiment in the journal."""
    return {"experiment": id, "inputs": point.declared, "cube": point.cube.tolist()}
