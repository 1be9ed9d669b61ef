"""The computational simulator: from the conditions of one experiment and the parameters of the model to a response."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false
# A compiled method is an object, and a field of this model has a narrower type than the abstract one.
# pyright: reportIncompatibleMethodOverride=false, reportIncompatibleVariableOverride=false

from abc import abstractmethod
from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, cast, final

import equinox as eqx
import jax
from jaxtyping import Array, Bool, Float

from hsed_jax.physics.effects.base import (
    AbstractEffect,
    AbstractSetupEffect,
    AbstractSpringEffect,
    Catalogue,
    Setup,
    combine,
)
from hsed_jax.physics.effects.shaped import Shaped
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations import AbstractExcitation, AbstractForcing, Shaken, Tabulated
from hsed_jax.physics.gates import Acts, gated
from hsed_jax.physics.laws import Elastic
from hsed_jax.physics.names import OWNER, number_of_spring, own_name, owner_of
from hsed_jax.physics.outputs import further
from hsed_jax.physics.parameters import dimensionless
from hsed_jax.physics.response import Response
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.sensors import felt, measured
from hsed_jax.physics.specimen import Specimen
from hsed_jax.physics.structures import Structure
from hsed_jax.physics.systems import AbstractSystem, DrivenSpring, ShakenStructure
from hsed_jax.physics.timeline import Timeline, times
from hsed_jax.programs import program

Scalar = Float[Array, ""] | float


class Recorded(NamedTuple):
    """A recorded excitation on the grid of its own experiment.

    Attributes:
        forcing: on the half-step grid.
        step_length: [s], zero where the record has ended.
        ends: number of steps before each sample of the record, where `every` is 1 and histories are kept at these only.
        stop: number of steps after which no output is needed, the same for all simulations that run together: later samples
            repeat the last one; None for the whole grid.
    """

    forcing: AbstractForcing
    step_length: Float[Array, " steps"]
    ends: Any = None
    stop: Any = None


class Conditions(NamedTuple):
    """The conditions that distinguish experiments.

    Attributes:
        inputs: by name, SI.
        recorded: its record, if it has one.
        acting: whether each effect of the model acts, and in more than its simplest shape, the same for all experiments that
            run together; an absent effect is not computed (`hsed_jax.physics.gates`).  None: all act; effects without an
            entry act, too.
    """

    inputs: Mapping[str, Scalar]
    recorded: Recorded | None = None
    acting: Mapping[str, Acts] | None = None

    @property
    def stop(self) -> Any:
        """Number of steps after which no output is needed; None for the whole grid."""
        return None if self.recorded is None else self.recorded.stop

    def until(self, stop: Any) -> "Conditions":
        """The same, without outputs after this number of steps."""
        return self if self.recorded is None else self._replace(recorded=self.recorded._replace(stop=stop))


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
                return tuple(map(told, cast(tuple[Any, ...], value)))
            return inputs[value] if isinstance(value, str) else value

        return self.constructor(**self.arrays, **{name: told(value) for name, value in self.arguments})


class AbstractModel(eqx.Module):
    """A computational model: from parameters and the conditions of one experiment to its predicted response.

    Calibration, design, comparison and report use only this interface; `Simulator` is the model of a spring law.

    Attributes:
        excitation: from inputs to its excitation; None if every experiment has its record, or no excitation exists.
        timeline: the grid of an experiment without a record; None without an excitation.
    """

    excitation: eqx.AbstractVar[Callable[[Mapping[str, Scalar]], AbstractExcitation] | None]
    timeline: eqx.AbstractVar[Timeline | None]

    @property
    @abstractmethod
    def owners(self) -> tuple[str, ...]:
        """The names of the predicted specimens; that of a single specimen is empty."""

    @abstractmethod
    def gives(self, name: str) -> bool:
        """Whether the model predicts a channel or quantity."""

    @property
    @abstractmethod
    def references(self) -> dict[str, str]:
        """The owners of its parts, by their names."""

    @abstractmethod
    def respond(
        self,
        parameters: Mapping[str, Scalar],
        conditions: Conditions,
        channels: tuple[str, ...] = (),
        quantities: tuple[str, ...] = (),
    ) -> Response:
        """The response of one experiment, differentiable in forward mode with respect to the parameters.

        Arguments:
            parameters: by name, SI.
            conditions: inputs and record of the experiment.
            channels: names of the histories to keep.
            quantities: names of those to keep beside the ones of Eq. 18.
        """

    @eqx.filter_jit
    def times(self, inputs: Mapping[str, Scalar]) -> Float[Array, " samples"]:
        """When the histories of an experiment without a record are kept [s], from t = 0."""
        assert self.excitation is not None and self.timeline is not None
        return times(self.excitation(inputs).step_length(self.timeline), self.timeline.every, self.timeline.samples)

    @program
    def quantities(self, parameters: Mapping[str, Scalar], conditions: Conditions, names: tuple[str, ...]):
        """The named quantities of one experiment, shape (len(names),), and whether it converged."""
        response = self.respond(parameters, conditions, quantities=further(names))
        return jax.numpy.stack([response.quantities[name] for name in names]), response.ok


@final
class Simulator(AbstractModel):
    """Spring laws with effects, in a structure under an excitation, or one alone under an imposed elongation.

    Attributes:
        structure: the numerical substructure; None for a component test.
        excitation: from inputs to its excitation; None where every experiment brings its record.
        timeline: the grid of the integration.
        effects: of spring, structure and test rig.
        scales: characteristic values for the effects; leaves, so that one compiled program can serve any.
        constants: parameters that are fixed numbers (and constants of the compiled program).
        damping_follows_model: form the damping matrix with the model's own stiffness instead of a reference one.
        elements: the specimens, in the order of the structure.
    """

    structure: Structure | None
    excitation: Callable[[Mapping[str, Scalar]], AbstractExcitation] | None
    timeline: Timeline = eqx.field(static=True)
    effects: Catalogue = eqx.field(static=True, default=Catalogue())
    scales: Scales = Scales()
    constants: tuple[tuple[str, float], ...] = eqx.field(static=True, default=())
    damping_follows_model: bool = eqx.field(static=True, default=False)
    elements: tuple[Element, ...] = eqx.field(static=True, default=(Element(),))

    @property
    def owners(self) -> tuple[str, ...]:
        """The names of the specimens; that of the only one is empty."""
        return tuple(element.name for element in self.elements)

    def gives(self, name: str) -> bool:
        """True: the build of a study checks which outputs its structure has."""
        return True

    @property
    def references(self) -> dict[str, str]:
        """Of the laws and of the effects."""
        laws = {element.law.name: element.law.reference for element in self.elements}
        return laws | {name: effect.reference for name, effect in self.effects.items()}

    def system(self, parameters: Mapping[str, Scalar]) -> AbstractSystem:
        """The integrated system; parameters of effects are named `effect.parameter`, in dimensionless or physical form."""
        given = self._given(parameters)
        return self._system(given, self._setup(given))

    def _system(self, given: "_Given", slots: Callable[..., Any] | None) -> AbstractSystem:
        specimens = [
            Specimen(element.law(**element.parameters(given.owners)), *given.of_spring(element.has, self.scales))
            for element in self.elements
        ]
        if self.structure is None:
            return DrivenSpring(tuple(specimens))
        structure = self.structure.told(given.owners[OWNER])
        if self.damping_follows_model:
            stiffness = tuple(specimen.law.stiffness for specimen in specimens)
            structure = eqx.tree_at(_stiffness_of_specimens, structure, stiffness)
        altered, damping = structure, None
        if slots is not None:
            # C is formed by the model without errors: an error of mass or stiffness does not change it.
            damping = slots("damping") * structure.damping_matrix()
            altered = structure.altered(slots("mass"), slots("support"))
        yielding = {
            i: Specimen(Elastic(spring.stiffness), *of_spring)
            for i, spring in enumerate(altered.springs)
            if (of_spring := given.of_spring(lambda owner, i=i: number_of_spring(owner) == i, self.scales))[0]
        }
        return ShakenStructure(altered, specimens, self.owners, damping, yielding)

    @program
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
        # Imported here, because building or checking a simulator needs no diffrax.
        from hsed_jax.physics.integrate import integrate

        steps, every = self.timeline.steps, self.timeline.every
        stop = None
        if conditions.recorded is not None:
            forcing, length, _, stop = conditions.recorded
        else:
            assert self.excitation is not None
            excitation = self.excitation(conditions.inputs)
            length = excitation.step_length(self.timeline)
            forcing = excitation.forcing(length, steps)
        given, is_gated = self._given(parameters, conditions.acting), conditions.acting is not None
        slots = self._setup(given)
        if slots is not None and self.structure is not None:
            forcing = Shaken(forcing, slots("ground_motion"))
        elif slots is not None:
            assert isinstance(forcing, Tabulated)
            imposed = partial(felt, forcing, slots, jax.numpy.asarray(length), is_gated=is_gated)
            forcing = gated(given.rig_acts, imposed, lambda f=forcing: f)
        system = self._system(given, slots)
        response = integrate(
            system, forcing, length, steps, channels=channels, quantities=quantities, every=every, stop=stop
        )
        if slots is not None:
            is_imposed = self.structure is None
            sensed = partial(measured, response, slots, length, every, is_imposed=is_imposed, is_gated=is_gated)
            response = gated(given.rig_acts, sensed, lambda r=response: r)
        if every > 1 or conditions.recorded is None or conditions.recorded.ends is None:
            return response
        at = conditions.recorded.ends
        return response._replace(channels={name: values[at] for name, values in response.channels.items()})

    def _given(self, parameters: Mapping[str, Scalar], acting: Mapping[str, Acts] | None = None) -> "_Given":
        owners: dict[str, dict[str, Scalar]] = defaultdict(dict)
        for name, value in {**dict(self.constants), **parameters}.items():
            owner, own = owner_of(name), own_name(name)
            if owner in self.effects:
                owners[owner].update(dimensionless(self.effects[owner], own, value, self.scales))
            else:
                owners[owner][own] = value

        def made(name: str, effect: type[AbstractEffect]) -> AbstractEffect:
            if acting is None or name not in acting or not issubclass(effect, AbstractSpringEffect):
                return effect(**owners[name])
            return Shaped.of(effect, owners[name], acting[name].is_shaped)

        return _Given(owners, {name: made(name, effect) for name, effect in self.effects.items()}, acting)

    def _setup(self, given: "_Given") -> Callable[..., Any] | None:
        """The slots of structure and test rig, and of the sensors of a specimen by its name; None where no effect writes."""
        effects = {name: e for name, e in given.effects.items() if isinstance(e, AbstractSetupEffect)}
        if not effects:
            return None
        structure = self.structure
        masses, supports = (0, 0) if structure is None else (len(structure.masses), len(structure.supports))
        setup = Setup(self.scales, masses, supports)

        def written(owner: str) -> Callable[[str], Any]:
            places = {"", owner}
            return combine([e.contribute(setup) for name, e in effects.items() if owner_of(name) in places])

        of_each = {element.name: written(element.name) for element in self.elements} | {"": written("")}

        def slot_of(slot: str, owner: str = "") -> Any:
            return of_each[owner](slot)

        return slot_of


def _stiffness_of_specimens(structure: Any) -> Any:
    return structure.damping.specimen_stiffness


class _Given(NamedTuple):
    """Parameters by owner, the effects by name, and whether each acts."""

    owners: dict[str, dict[str, Scalar]]
    effects: dict[str, AbstractEffect]
    acting: Mapping[str, Acts] | None

    def of_spring(
        self, has: Callable[[str], bool], scales: Scales
    ) -> tuple[tuple[AbstractSpringEffect, ...], Scales, tuple[Bool[Array, ""], ...] | None]:
        """The effects in a spring, by owner, and the other parts of a specimen."""
        own = {
            name: effect
            for name, effect in self.effects.items()
            if isinstance(effect, AbstractSpringEffect) and has(owner_of(name))
        }
        return tuple(own.values()), scales, None if self.acting is None else tuple(map(self._acts, own))

    def _acts(self, effect: str) -> Bool[Array, ""]:
        assert self.acting is not None
        return self.acting[effect].acts if effect in self.acting else jax.numpy.asarray(True)

    @property
    def rig_acts(self) -> Bool[Array, ""] | None:
        """Whether any effect outside the springs acts; None if all act."""
        if self.acting is None:
            return None
        outside = [self._acts(name) for name, e in self.effects.items() if isinstance(e, AbstractSetupEffect)]
        return jax.numpy.any(jax.numpy.stack(outside))
