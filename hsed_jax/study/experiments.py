"""The experiments of a study, measured or planned: their excitation, their inputs and their measurements."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from hsed_jax.config.schema import Study
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError, at
from hsed_jax.measurements import (
    Campaign,
    Characteristics,
    Experiment,
    Record,
    characteristics,
    parse_unit,
    read_campaign,
)
from hsed_jax.measurements.header import Protocol
from hsed_jax.measurements.thinning import loss, thinned
from hsed_jax.physics.excitations import AbstractExcitation
from hsed_jax.physics.simulator import Parametrised
from hsed_jax.study import parts
from hsed_jax.study.excitations import excitation_of, protocol_of

# Records whose thinning is told.
_TOLD = 3


@dataclass(frozen=True)
class Experiments:
    """The experiments of a study.

    Attributes:
        study: of the user.
        campaign: measured experiments; by default the campaign that the study names.
    """

    study: Study
    campaign: Campaign | None = None

    @cached_property
    def measured(self) -> Campaign | None:
        """The campaign of measurements, if the study has one."""
        path = self.study.experiments.campaign
        if self.campaign is not None or path is None:
            return self.campaign
        try:
            return read_campaign(self.study.folder / path)
        except UserError as error:
            raise parts.in_study(self.study.file, error) from None

    @cached_property
    def protocol(self) -> Protocol:
        """The excitation of the experiments: ground motion, a force, or an elongation imposed on the specimen alone."""
        return protocol_of(self.study, self.measured)

    @property
    def component_test(self) -> bool:
        """Whether the elongation is imposed on the specimen alone."""
        return self.protocol == "displacement"

    @cached_property
    def space(self) -> InputSpace:
        """The variable inputs."""
        inputs = self.study.inputs
        units = {name: at(f"inputs.{name}.unit", parse_unit, entry.unit) for name, entry in inputs.items()}
        return InputSpace(
            {name: parts.prior(f"inputs.{name}", entry.prior) for name, entry in inputs.items()},
            {name: entry.unit for name, entry in inputs.items()},
            {name: float(unit.to_si(1.0)) for name, unit in units.items()},
        )

    @cached_property
    def excitation(self) -> Parametrised[AbstractExcitation] | None:
        """From inputs to the excitation of an experiment; None if every experiment has its record."""
        return excitation_of(self.study)

    @cached_property
    def characteristics(self) -> Characteristics | None:
        """Characteristic values of the measured campaign."""
        return None if self.measured is None else characteristics(self.measured)

    def taken(self, experiments: Sequence[Experiment]) -> tuple[Experiment, ...]:
        """Experiments as they are fitted and scored: long records of a component test are thinned."""
        if not self.component_test:
            return tuple(experiments)
        # Every selection of the experiments keeps the same samples of a record.
        windows = (*(() if self.measured is None else self.measured.completed), *experiments)
        return tuple(thinned(e, self.study.measurements.samples, windows) for e in experiments)

    def thinning_notes(self, campaign: Campaign) -> list[str]:
        """The thinning of the records of a campaign, in a sentence each: those that lose most, and the number of the others."""
        full = campaign.completed.experiments
        pairs = [(a.id, a.scored, b.scored) for a, b in zip(full, self.taken(full), strict=True) if a is not b]
        losses = {id: loss(a, b) for id, a, b in pairs if a is not None and b is not None}
        told = sorted(losses, key=lambda id: -losses[id].deviation)[:_TOLD]
        rest = len(losses) - len(told)
        also = [f"{rest} other records are thinned, too, and lose less"] if rest else []
        return [f"{id} is {losses[id]}" for id in losses if id in told] + also

    @cached_property
    def records(self) -> list[Record]:
        """Records of the measured experiments, after thinning; none without measurements.

        Raises:
            UserError: the campaign has no completed experiment.
        """
        campaign = self.measured
        if campaign is None:
            return []
        if not len(campaign.completed):
            raise UserError(f"the campaign {campaign.name!r} has no completed experiment")
        return [e.record for e in self.taken(campaign.completed.experiments) if e.record is not None]

    def quantile(self, share: float) -> dict[str, float]:
        """Every input at a quantile of its distribution, SI."""
        space = self.space
        return {name: float(prior.quantile(share)) * space.factors[name] for name, prior in space.priors.items()}

    @cached_property
    def duration(self) -> float:
        """Duration of a planned experiment in the middle of the inputs [s]."""
        entry = self.study.excitation
        assert entry is not None and self.excitation is not None
        return float(self.excitation(self.quantile(0.5)).duration) if entry.duration is None else entry.duration
