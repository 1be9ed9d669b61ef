"""Outcomes of a run, and runs and designs whose results are given."""

from dataclasses import fields
from types import SimpleNamespace

from builders.calibrations import STUDY
from hsed_jax.runs.ask_tell import AskTell
from hsed_jax.runs.outcome import Outcome
from hsed_jax.runs.workflow import Run
from hsed_jax.study.build import Built


def outcome(**given):
    """The outcome of a run of the paper's case that did nothing, but for what is given."""
    built = Built(STUDY)
    known = {
        "study": STUDY.study,
        "status": "complete",
        "posterior": built.inference.posterior,
        "model": built.simulation.simulator,
        "catalogue": built.mechanics.catalogue,
        "units": built.mechanics.units,
        "campaign": built.site.empty_campaign(),
        "space": built.experiments.space,
        "initial": 1,
        "steps": [],
        "stop_reason": "iterations",
    }
    return Outcome(**{**{field.name: None for field in fields(Outcome)}, **known, **given})


class Ended(Run):
    """A run that has ended with a given outcome; without one, it had no design."""

    def __init__(self, outcome=None):
        self.study, self.ended = STUDY, outcome
        self.conduct = None if outcome is None else SimpleNamespace(steps=outcome.steps)

    def outcome(self, status):
        return self.ended


class Expecting(AskTell):
    """A design by hand that expects what is given."""

    def __init__(self, built, conduct, expected):
        self.built, self.conduct, self.given, self.path = built, conduct, expected, "here"

    def expected(self, asked):
        return self.given

    def folder(self, id):
        return "there"
