"""The model of a run with effects added and removed, simulated while sliders move."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.config.load import load_study
from hsed_jax.diagnosis.candidates import applicable, with_effects
from hsed_jax.errors import UserError
from hsed_jax.inference.observation import conditions_of
from hsed_jax.measurements import Campaign, Experiment, read_campaign
from hsed_jax.physics.names import own_name, owner_of
from hsed_jax.physics.pairs import Pair
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.simulator import AbstractModel, Conditions
from hsed_jax.study.build import Built

# Quantiles of a prior at the ends of a slider.
_ENDS = (0.02, 0.98)


class Dial(NamedTuple):
    """A parameter with a slider: its name, unit, meaning, the ends of the slider, and its position."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    value: float


class Start(NamedTuple):
    """A model that a run found: its effects, and its parameters [SI] by name."""

    effects: tuple[str, ...]
    parameters: dict[str, float]


class Loop(NamedTuple):
    """The prediction of a model for an experiment: elongation and force (n,) [SI], and the normalised error of the observed
    outputs.
    """

    elongation: np.ndarray
    force: np.ndarray
    error: float


@dataclass(frozen=True)
class Variant:
    """The model with some effects, compiled at its first use."""

    built: Built
    campaign: Campaign

    @cached_property
    def dials(self) -> list[Dial]:
        """Its free parameters, in the middle of their priors."""
        mechanics, found = self.built.mechanics, []
        free, _ = mechanics.parameters
        for name, prior in free.items():
            low, middle, high = (float(prior.quantile(share)) for share in (_ENDS[0], 0.5, _ENDS[1]))
            meaning, neutral = self._known(name)
            if neutral is not None:
                low, high = min(low, neutral), max(high, neutral)
            found.append(Dial(name, mechanics.units[name], mechanics.pair.words(meaning), low, high, middle))
        return found

    def simulate(self, parameters: Mapping[str, float], experiment: Experiment) -> Loop:
        """The response to the excitation of an experiment.

        Arguments:
            parameters: all free ones by name, SI.
            experiment: of the campaign.

        Raises:
            UserError: the integration diverged.
        """
        built = self.built
        (taken,) = built.experiments.taken((experiment,))
        assert taken.record is not None
        names = tuple(dict.fromkeys(("elongation", "force", *built.observed.outputs)))
        free = {name: jnp.asarray(parameters[name], dtype=float) for name in built.mechanics.parameters[0]}
        conditions = conditions_of(taken, self.campaign, built.simulation.grid, built.experiments.excitation)
        channels, ok = _responded(built.simulation.simulator, names, free, conditions)
        if not bool(ok):
            raise UserError("the integration diverged: such a specimen cannot be simulated")
        size = len(taken.record)
        channels = {name: np.asarray(values)[:size] for name, values in channels.items()}
        return Loop(channels["elongation"], channels["force"], self._error(channels, taken))

    def _error(self, channels: Mapping[str, np.ndarray], experiment: Experiment) -> float:
        """The normalised root-mean-square error over the observed channels, as a comparison has it."""
        record = experiment.record
        assert record is not None
        first, last = experiment.window or (-np.inf, np.inf)
        inside = (record.time >= first) & (record.time <= last)
        shares = []
        for name in self.built.observed.outputs:
            if name in record.channels:
                used = inside & np.isfinite(record.channels[name])
                measured = record.channels[name][used]
                shares.append(np.mean((channels[name][used] - measured) ** 2) / max(float(np.var(measured)), 1e-300))
        return float(np.sqrt(np.mean(shares))) if shares else float("nan")

    def _known(self, name: str) -> tuple[str, float | None]:
        """The meaning of a parameter, and its neutral value; a law has no neutral value for a slider."""
        owner, own = owner_of(name), own_name(name)
        if owner in self.built.mechanics.catalogue:
            effect = parameters_of(self.built.mechanics.catalogue[owner])
            if own in effect:
                return effect[own].meaning, effect[own].neutral
            return next((p.meaning for p in effect.values() if p.physical and p.physical.name == own), own), None
        known = self.built.mechanics.known(name)
        return (own if known is None else known.meaning), None


@eqx.filter_jit
def _responded(
    model: AbstractModel, channels: tuple[str, ...], parameters: Mapping[str, Any], conditions: Conditions
) -> tuple[dict[str, jax.Array], jax.Array]:
    response = model.respond(parameters, conditions, channels)
    return response.channels, response.ok


class Explorer:
    """The result of a run, for interactive changes.

    Arguments:
        run: the run folder.

    Attributes:
        starts: models to start from, by their names on the page.
        experiments: those with a loop, by id.

    Raises:
        UserError: the run has no results yet, its study names code, or no experiment has a loop.
    """

    def __init__(self, run: Path):
        try:
            summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
            plain = summary["calibration"]["map"]
        except (OSError, ValueError, KeyError):
            raise UserError("the run has no calibrated model yet; wait for its end") from None
        self._study = load_study(run / "study.yaml")
        if self._study.code:
            raise UserError(
                "the study uses code of your own, which this page does not execute; use hx.simulate in Python"
            )
        self._campaign = read_campaign(run / "campaign")
        shown = {"elongation", "force"}
        self.experiments = {
            e.id: e for e in self._campaign.completed if e.record is not None and shown <= e.record.channels.keys()
        }
        if not self.experiments:
            raise UserError("no experiment has a record of both elongation and force, so there is no loop to see")
        diagnosis = summary.get("diagnosis", {})
        self._forms = {entry["effect"]: entry["form"] for entry in diagnosis.get("ranking", []) if entry.get("form")}
        self._variants: dict[tuple[str, ...], Variant] = {}
        built = Built(self._study, self._campaign)
        own = tuple(getattr(self._study.model, "effects", {}))
        self.effects = [*own, *applicable(built, self._campaign)]
        """Effects that can be ticked."""
        self.catalogue = built.mechanics.catalogue
        self.starts = {"the model as it was": Start(own, plain)}
        improved = summary.get("improvement", {}).get("map", {})
        added = tuple(dict.fromkeys(owner_of(name) for name in improved if owner_of(name) in self.effects))
        if improved and self.variant(added).built.mechanics.parameters[0].keys() <= improved.keys():
            self.starts["the improved model"] = Start(added, improved)

    @property
    def pair(self) -> Pair:
        """The pair of elongation and force."""
        return self._campaign.pair

    @property
    def is_measured(self) -> bool:
        """Whether the run is of a campaign of measurements."""
        return self._study.experiments.campaign is not None

    def unit(self, channel: str):
        """The declared unit of a channel."""
        return self._campaign.unit(channel)

    def variant(self, effects: Sequence[str]) -> Variant:
        """The model with these effects and no others.

        Raises:
            UserError: the model cannot have one of them.
        """
        key = tuple(name for name in self.effects if name in effects)
        if key not in self._variants:
            model = self._study.model
            kept = {name: entry for name, entry in model.effects.items() if name in key}
            base = self._study.model_copy(update={"model": model.model_copy(update={"effects": kept})})
            built = Built(base, self._campaign)
            if added := [name for name in key if name not in kept]:
                built = Built(
                    with_effects(built, added, {n: self._forms[n] for n in added if n in self._forms}), self._campaign
                )
            self._variants[key] = Variant(built, self._campaign)
        return self._variants[key]
