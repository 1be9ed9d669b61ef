"""From what a user said to the objects that compute: no `None` reaches the numerics."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from hsed_jax.config.schema import ErrorEntry, Study
from hsed_jax.design.sequential import SequentialDesign
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.inference.nuts import Settings
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import predictor
from hsed_jax.inference.priors import Prior
from hsed_jax.laboratories.virtual import Noise, VirtualLaboratory
from hsed_jax.measurements import parse_unit, read_at2
from hsed_jax.physics.bouc_wen import BoucWen
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.excitations import NearFaultPulse, RecordedMotion
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Parametrised, Simulator, Timeline
from hsed_jax.physics.structures import ModalDamping, RayleighDamping, Spring, Structure

# The integration resolves the shortest period with this many steps; peaks are then good to 1e-4 (tests/test_response.py).
STEPS_PER_PERIOD = 24
UNKNOWN_ERROR = Prior("half_normal", 0.3)


@dataclass(frozen=True)
class Built:
    """Everything a study needs to run."""

    study: Study
    folder: Path

    @cached_property
    def space(self) -> InputSpace:
        """The variable inputs."""
        units = {name: _at(f"inputs.{name}.unit", parse_unit, entry.unit) for name, entry in self.study.inputs.items()}
        return InputSpace(
            {name: _prior(f"inputs.{name}", entry.prior) for name, entry in self.study.inputs.items()},
            {name: entry.unit for name, entry in self.study.inputs.items()},
            {name: float(unit.to_si(1.0)) for name, unit in units.items()},
        )

    @cached_property
    def structure(self) -> Structure | None:
        """The numerical substructure."""
        entry = self.study.structure
        if entry is None:
            return None
        stiffness = entry.damping.specimen_stiffness
        reference = 1.0 if stiffness == "model" else float(stiffness)
        if entry.damping.rayleigh is not None:
            damping = RayleighDamping(entry.damping.rayleigh.alpha, entry.damping.rayleigh.beta, reference)
        else:
            damping = ModalDamping(jnp.asarray(entry.damping.modal), reference)
        springs = [Spring(_ends(s.between), s.stiffness) for s in entry.springs]
        try:
            return Structure(entry.masses, springs, _ends(entry.specimen.between), damping)
        except ValueError as error:
            raise UserError(f"structure: {error}") from None

    @cached_property
    def parameters(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Free parameters of the model with their priors, and the fixed ones with their values."""
        model = self.study.model
        given: dict[str, Any] = {}
        _check_names("model.parameters", model.parameters, _law_parameters())
        for name, known in _law_parameters().items():
            if name in model.parameters:
                given[name] = (known, model.parameters[name])
            elif known.neutral is None:
                raise UserError(f"model.parameters.{name}: this key is required ({known.meaning}, {known.unit})")
        for effect, entries in model.effects.items():
            forms = _effect_parameters("model.effects", effect, entries)
            named = {forms[name].name for name in entries}
            for name, entry in entries.items():
                given[f"{effect}.{name}"] = (forms[name], entry)
            for known in parameters_of(EFFECTS[effect]).values():
                if known.name not in named:
                    assert known.prior is not None
                    given[f"{effect}.{known.name}"] = (known, dict(known.prior))
        free, fixed = {}, {}
        for name, (known, entry) in given.items():
            effect, _, rest = name.rpartition(".")
            where = f"model.effects.{effect}.{rest}" if effect else f"model.parameters.{name}"
            if isinstance(entry, dict):
                free[name] = _prior(where, entry)
            else:
                fixed[name] = _within(where, float(entry), known)
        if not free:
            raise UserError("model.parameters: at least one parameter needs a prior, such as A: {uniform: [2.0e5, 9.0e5]}")
        return free, fixed

    @cached_property
    def timeline(self) -> Timeline:
        """The grid of the integration."""
        entry = self.study.excitation
        if entry is None:
            raise UserError("excitation: this key is required, unless the campaign brings its records")
        duration = entry.duration if entry.duration is not None else self._record_duration()
        step = entry.step if entry.step is not None else self._shortest_period() / STEPS_PER_PERIOD
        if step > duration:
            raise UserError(f"excitation.step: {step:g} s is longer than the duration, {duration:g} s")
        steps = math.ceil(duration / step - 1e-9)
        return Timeline(duration / steps, steps)

    @cached_property
    def simulator(self) -> Simulator:
        """The computational simulator."""
        _, fixed = self.parameters
        return self._simulator(tuple(self.study.model.effects), fixed)

    @cached_property
    def laboratory(self) -> VirtualLaboratory:
        """Where experiments are performed."""
        entry = self.study.experiments.virtual
        assert entry is not None
        _check_names("experiments.virtual.parameters", entry.parameters, _law_parameters())
        truth = {
            name: _within(f"experiments.virtual.parameters.{name}", value, _law_parameters()[name])
            for name, value in entry.parameters.items()
        }
        for name, known in _law_parameters().items():
            if known.neutral is None and name not in truth:
                raise UserError(f"experiments.virtual.parameters.{name}: this key is required ({known.meaning})")
        for effect, values in entry.effects.items():
            forms = _effect_parameters("experiments.virtual.effects", effect, values)
            for name, value in values.items():
                truth[f"{effect}.{name}"] = _within(f"experiments.virtual.effects.{effect}.{name}", value, forms[name])
        noise = {}
        for name, error in _per_output("experiments.virtual.noise", entry.noise, self.study.quantities).items():
            if error.unknown:
                raise UserError(f"experiments.virtual.noise: the noise of {name} must be a number: relative or absolute")
            relative = error.relative is not None
            noise[name] = Noise(float(error.relative if relative else error.absolute or 0.0), relative)
        simulator = self._simulator(tuple(entry.effects), {})
        return VirtualLaboratory(simulator, truth, tuple(self.study.quantities), noise, self.study.seed)

    @cached_property
    def errors(self) -> tuple[list[float | Prior], np.ndarray]:
        """Per quantity: the error s, a number or a prior; and whether it is relative."""
        given = _per_output("error", self.study.error, self.study.quantities)
        errors: list[float | Prior] = []
        relative = []
        for name in self.study.quantities:
            entry = given.get(name, ErrorEntry(unknown=True))
            errors.append(UNKNOWN_ERROR if entry.unknown else float(entry.relative or entry.absolute or 0.0))
            relative.append(entry.absolute is None)
        return errors, np.asarray(relative)

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior of the study."""
        free, _ = self.parameters
        names, quantities, simulator = tuple(free), tuple(self.study.quantities), self.simulator

        def respond(theta, conditions):
            parameters = dict(zip(names, theta, strict=True))
            return simulator.quantities(parameters, conditions, quantities)

        return Posterior(predictor(respond), free, self.errors[0], quantities)

    @cached_property
    def design(self) -> SequentialDesign:
        """The sequential design."""
        entry, sizes = self.study.design, self.study.calibration
        return SequentialDesign(
            posterior=self.posterior,
            space=self.space,
            size=entry.initial + entry.iterations,
            relative=self.errors[1],
            settings=Settings(sizes.chains, sizes.step_warmup, sizes.step_draws, sizes.target_acceptance),
            starts=sizes.starts,
            candidates=entry.candidates,
            acquisition=entry.acquisition,
            kriging=entry.kriging.model_dump(),
            variance_over_parameters=entry.variance == "inputs_and_parameters",
            seed=self.study.seed,
        )

    @property
    def units(self) -> dict[str, str]:
        """SI unit of every parameter that is estimated."""
        known = _law_parameters()
        units = {name: known[name].unit if name in known else "1" for name in self.posterior.model_names}
        for name in self.posterior.model_names:
            effect, _, rest = name.rpartition(".")
            for parameter in parameters_of(EFFECTS[effect]).values() if effect else ():
                if parameter.physical is not None and parameter.physical.name == rest:
                    units[name] = parameter.physical.unit
        return units

    def check(self) -> None:
        """Build everything that can be wrong, and compute nothing.

        Raises:
            UserError: something is.
        """
        if not self.study.inputs:
            raise UserError("inputs: a design needs at least one input, such as V_P: {uniform: [1.5, 3.0], unit: m/s}")
        for part in ("space", "structure", "parameters", "timeline", "simulator", "laboratory", "errors"):
            getattr(self, part)

    def _simulator(self, effects: tuple[str, ...], constants: Mapping[str, float]) -> Simulator:
        entry = self.study.structure
        if entry is None:
            raise UserError("structure: this key is required, unless the elongation was imposed (a component test)")
        return Simulator(
            self.structure,
            self._excitation(),
            self.timeline,
            effects,
            Scales(),
            tuple(constants.items()),
            entry.damping.specimen_stiffness == "model",
        )

    def _excitation(self):
        entry = self.study.excitation
        if entry is None or (entry.near_fault_pulse is None and entry.recorded is None):
            raise UserError("excitation: give near_fault_pulse or recorded")
        if entry.near_fault_pulse is not None:
            arguments = entry.near_fault_pulse.model_dump()
            constructor: Any = NearFaultPulse
        else:
            motion, scale = self._motion(), entry.recorded.scale if entry.recorded else 1.0
            arguments = {"scale": scale}

            def constructor(scale):
                return RecordedMotion(motion.time, scale * motion.ground_acceleration)

        for name, value in arguments.items():
            if isinstance(value, str) and value not in self.study.inputs:
                known = ", ".join(self.study.inputs) or "none"
                raise UserError(f"excitation: {name} refers to {value!r}, which is no input; inputs are {known}")
        return Parametrised(constructor, tuple(arguments.items()))

    def _motion(self) -> RecordedMotion:
        assert self.study.excitation is not None and self.study.excitation.recorded is not None
        step, acceleration = read_at2(self.folder / self.study.excitation.recorded.file)
        return RecordedMotion(step * np.arange(len(acceleration)), acceleration)

    def _record_duration(self) -> float:
        return float(self._motion().time[-1])

    def _shortest_period(self) -> float:
        """Of the structure with the specimen at the upper end of its stiffness, and of the pulse."""
        free, fixed = self.parameters
        stiffest = fixed["A"] if "A" in fixed else float(free["A"].quantile(0.999))
        assert self.structure is not None
        periods = [1 / float(self.structure.frequencies(stiffest)[-1])]
        pulse = self.study.excitation.near_fault_pulse if self.study.excitation else None
        if pulse is not None:
            shortest = pulse.T_P
            if isinstance(shortest, str) and shortest in self.study.inputs:
                place = self.space.names.index(shortest)
                shortest = float(self.space.bounds()[place, 0]) * self.space.factors[shortest]
            if not isinstance(shortest, str):
                periods.append(shortest)
        return min(periods)


def _law_parameters() -> dict[str, Parameter]:
    return parameters_of(BoucWen)


def _effect_parameters(where: str, effect: str, entries: Mapping[str, Any]) -> dict[str, Parameter]:
    """Parameters of an effect under both their names, the dimensionless and the physical one."""
    if effect not in EFFECTS:
        raise UserError(f"{where}.{effect}: there is no such effect; the catalogue has {', '.join(EFFECTS)}")
    known = parameters_of(EFFECTS[effect])
    forms = {**known, **{p.physical.name: p for p in known.values() if p.physical is not None}}
    _check_names(f"{where}.{effect}", entries, forms)
    return forms


def _check_names(where: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    for name in given:
        if name not in known:
            raise UserError(f"{where}.{name}: there is no such parameter; allowed here are {', '.join(known)}")


def _within(where: str, value: float, known: Parameter) -> float:
    if not known.lower <= value <= known.upper:
        raise UserError(f"{where}: {value:g} is outside what is possible, {known.lower:g} to {known.upper:g} {known.unit}")
    return value


def _per_output(
    where: str, entry: ErrorEntry | dict[str, ErrorEntry] | None, outputs: list[str]
) -> dict[str, ErrorEntry]:
    if entry is None:
        return {}
    if isinstance(entry, ErrorEntry):
        return dict.fromkeys(outputs, entry)
    for name in entry:
        if name not in outputs:
            raise UserError(f"{where}.{name}: this is not observed; observed are {', '.join(outputs)}")
    return dict(entry)


def _prior(where: str, entry: Mapping[str, Any]) -> Prior:
    ((name, arguments),) = entry.items()
    return _at(where, Prior, str(name), arguments)


def _at[T](where: str, make: Any, *arguments: Any) -> T:
    """Call, and put the place in front of what is wrong."""
    try:
        return make(*arguments)
    except UserError as error:
        raise UserError(f"{where}: {error}") from None


def _ends(between: tuple[Any, Any]) -> tuple[int | None, int | None]:
    first, second = (None if end == "ground" else int(end) - 1 for end in between)
    return first, second
