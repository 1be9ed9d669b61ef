"""The computational simulator: from the conditions of one experiment and the parameters of the model to a response."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
from jaxtyping import Array, Float

from hsed_jax.physics.effects.base import (
    AbstractEffect,
    AbstractSetupEffect,
    AbstractSpringEffect,
    Catalogue,
    Setup,
    combine,
)
from hsed_jax.physics.excitations import AbstractExcitation, AbstractForcing, Shaken, Tabulated
from hsed_jax.physics.laws import BoucWen
from hsed_jax.physics.laws.base import AbstractSpringLaw
from hsed_jax.physics.outputs import further
from hsed_jax.physics.parameters import dimensionless
from hsed_jax.physics.response import Response
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.sensors import felt, measured
from hsed_jax.physics.specimen import Specimen
from hsed_jax.physics.structures import OWNER, Structure
from hsed_jax.physics.systems import AbstractSystem, DrivenSpring, ShakenStructure
from hsed_jax.physics.timeline import Timeline, times

Scalar = Float[Array, ""] | float


class Recorded(NamedTuple):
    """A recorded excitation on the grid of its own experiment."""

    forcing: AbstractForcing
    step_length: Float[Array, " steps"]


class Conditions(NamedTuple):
    """What distinguishes one experiment from another: its inputs by name (SI), and its record where it has one."""

    inputs: Mapping[str, Scalar]
    recorded: Recorded | None = None


@final
class Parametrised[T](eqx.Module):
    """A constructor whose arguments are fixed arrays, and numbers or names of inputs, one or a tuple of them."""

    constructor: Callable[..., T] = eqx.field(static=True)
    arguments: tuple[tuple[str, Any], ...] = eqx.field(static=True)
    arrays: Mapping[str, Any] = eqx.field(default_factory=dict)

    def __call__(self, inputs: Mapping[str, Scalar]) -> T:
        """The object at these inputs."""

        def told(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(told(one) for one in value)
            return inputs[value] if isinstance(value, str) else value

        return self.constructor(**self.arrays, **{name: told(value) for name, value in self.arguments})


@final
class Simulator(eqx.Module):
    """A spring law with effects, in a structure under an excitation, or alone under an imposed elongation.

    Attributes:
        structure: the numerical substructure; None for a component test.
        excitation: from inputs to what drives it; None where every experiment brings its record.
        timeline: the grid of the integration.
        effects: of spring, structure and test rig.
        scales: characteristic values for the effects; leaves, so that one compiled program can serve any.
        constants: parameters that are fixed numbers (and constants of the compiled program).
        damping_follows_model: form the damping matrix with the model's own stiffness instead of a reference one.
        law: of the spring.
    """

    structure: Structure | None
    excitation: Callable[[Mapping[str, Scalar]], AbstractExcitation] | None
    timeline: Timeline = eqx.field(static=True)
    effects: Catalogue = eqx.field(static=True, default=Catalogue())
    scales: Scales = Scales()
    constants: tuple[tuple[str, float], ...] = eqx.field(static=True, default=())
    damping_follows_model: bool = eqx.field(static=True, default=False)
    law: type[AbstractSpringLaw] = eqx.field(static=True, default=BoucWen)

    def specimen(self, parameters: Mapping[str, Scalar]) -> Specimen:
        """The law with its effects; parameters of effects are named `effect.parameter`, in dimensionless or physical form."""
        law, effects, _ = self._given(parameters)
        of_spring = tuple(effect for effect in effects if isinstance(effect, AbstractSpringEffect))
        return Specimen(self.law(**law), of_spring, self.scales)

    def system(self, parameters: Mapping[str, Scalar]) -> AbstractSystem:
        """What is integrated."""
        specimen = self.specimen(parameters)
        if self.structure is None:
            return DrivenSpring(specimen)
        structure = self.structure.told(self._given(parameters)[2])
        if self.damping_follows_model:
            structure = eqx.tree_at(lambda s: s.damping.specimen_stiffness, structure, specimen.law.stiffness)
        slots = self._setup(parameters)
        if slots is None:
            return ShakenStructure(structure, specimen)
        # C is what the model was built with: an error of mass or stiffness does not carry over to it.
        damping = slots("damping") * structure.damping_matrix()
        return ShakenStructure(structure.altered(slots("mass"), slots("support")), specimen, damping)

    @eqx.filter_jit
    def respond(
        self,
        parameters: Mapping[str, Scalar],
        conditions: Conditions,
        channels: tuple[str, ...] = (),
        quantities: tuple[str, ...] = (),
    ) -> Response:
        """The response of one experiment, as the test rig measures it.

        Compiled once for all simulators that differ in arrays only.

        Arguments:
            parameters: by name, SI.
            conditions: inputs and record of the experiment.
            channels: names of the histories to keep.
            quantities: names of those to keep beside the ones of Eq. 18.
        """
        # Here and not above: what only builds or checks a simulator does without diffrax.
        from hsed_jax.physics.integrate import integrate

        steps, every = self.timeline.steps, self.timeline.every
        if conditions.recorded is not None:
            forcing, length = conditions.recorded
        else:
            assert self.excitation is not None
            excitation = self.excitation(conditions.inputs)
            length = excitation.step_length(self.timeline)
            forcing = excitation.forcing(length, steps)
        slots = self._setup(parameters)
        if slots is not None and self.structure is not None:
            forcing = Shaken(forcing, slots("ground_motion"))
        elif slots is not None:
            assert isinstance(forcing, Tabulated)
            forcing = felt(forcing, slots, jax.numpy.asarray(length))
        system = self.system(parameters)
        response = integrate(system, forcing, length, steps, channels=channels, quantities=quantities, every=every)
        response = response._replace(ok=response.ok & system.specimen.law.is_bounded)
        if slots is None:
            return response
        return measured(response, slots, length, every, is_imposed=self.structure is None)

    @eqx.filter_jit
    def times(self, inputs: Mapping[str, Scalar]) -> Float[Array, " samples"]:
        """When the histories of an experiment without a record are kept [s], from t = 0."""
        assert self.excitation is not None
        return times(self.excitation(inputs).step_length(self.timeline), self.timeline.every, self.timeline.samples)

    @eqx.filter_jit
    def quantities(self, parameters: Mapping[str, Scalar], conditions: Conditions, names: tuple[str, ...]):
        """The named quantities of one experiment, shape (len(names),), and whether it converged."""
        response = self.respond(parameters, conditions, quantities=further(names))
        return jax.numpy.stack([response.quantities[name] for name in names]), response.ok

    def _given(
        self, parameters: Mapping[str, Scalar]
    ) -> tuple[dict[str, Scalar], list[AbstractEffect], dict[str, Scalar]]:
        """Parameters of the spring law, the effects, and numbers of the structure."""
        law: dict[str, Scalar] = {}
        of_structure: dict[str, Scalar] = {}
        of_effects: dict[str, dict[str, Scalar]] = {effect: {} for effect in self.effects}
        for name, value in {**dict(self.constants), **parameters}.items():
            effect, _, rest = name.rpartition(".")
            if effect == OWNER:
                of_structure[rest] = value
            elif effect:
                of_effects[effect].update(dimensionless(self.effects[effect], rest, value, self.scales))
            else:
                law[name] = value
        return law, [self.effects[effect](**values) for effect, values in of_effects.items()], of_structure

    def _setup(self, parameters: Mapping[str, Scalar]) -> Callable[[str], Any] | None:
        """The slots of structure and test rig; None where no effect writes to them."""
        effects = [effect for effect in self._given(parameters)[1] if isinstance(effect, AbstractSetupEffect)]
        if not effects:
            return None
        structure = self.structure
        masses, supports = (0, 0) if structure is None else (len(structure.masses), len(structure.supports))
        setup = Setup(self.scales, masses, supports)
        return combine([effect.contribute(setup) for effect in effects])
