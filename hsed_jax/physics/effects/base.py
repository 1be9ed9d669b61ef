"""The base of every physical effect: parameters with a neutral value, the states it needs, its contributions to named slots."""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple, final

import equinox as eqx
from jaxtyping import Array, Float

from hsed_jax.physics.names import OWNER
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.states import SharedState
from hsed_jax.registry import register as register
from hsed_jax.registry import registered as registered

Scalar = Float[Array, ""] | float

# The first line of each belongs to the spring, the others to structure and test rig.
MULTIPLIED = (
    *("a", "nu", "eta", "h"),
    *("mass", "support", "damping", "ground_motion", "force_gain", "elongation_gain"),
)
ADDED = (
    *("force", "n", "gamma", "compliance", "slack", "plastic"),
    *("force_offset", "settling_offset", "settling_rate", "force_drift", "drift_onset", "drift_slowing"),
    *("elongation_delay", "force_delay"),
)


class SpringPoint(NamedTuple):
    r"""The state of the spring at one instant, as an effect in the spring sees it.

    Attributes:
        elongation: Δu [m].
        rate: Δu̇ [m/s].
        hysteretic: z [N], the force of the element of the law.  In a law of paths, only `force` sees the current value; the other
            slots see the value of the last commit.
        memory: further states by name, among them `energy` e [J].
        scales: characteristic values.
        strength: yield force of the virgin element, or the bound $[A/(\beta+\gamma)]^{1/n}$ of Bouc–Wen [N].  A law without a
            yield force gives a substitute (`AbstractSpringLaw.yardstick`).
        stiffness: of the virgin element [N/m].
    """

    elongation: Scalar
    rate: Scalar
    hysteretic: Scalar
    memory: dict[str, Scalar]
    scales: Scales
    strength: Scalar
    stiffness: Scalar


class Setup(NamedTuple):
    """The structure, as an effect outside the spring sees it.

    Attributes:
        scales: characteristic values.
        masses: number of masses of the structure (none in a component test).
        supports: number of its springs to the ground.
    """

    scales: Scales
    masses: int
    supports: int


@dataclass(frozen=True)
class Form:
    """One formula of an effect.

    Attributes:
        name: its name in studies and reports, unique within the effect; empty if the effect has only one formula.
        equation: LaTeX; empty if the description of the effect has it.
        reference: its source; empty if it is the source of the effect.
        held: parameters that it fixes, with their values.
        free: shape parameters that are free in this form, in addition to those that are free in every form.
        driver: the name of its driver; empty if there is no choice.
        is_default: whether a study that names no form means this one.
        in_units: whether its parameters may also be given in SI units.  They may not if the unit depends on the shape.
    """

    name: str = ""
    equation: str = ""
    reference: str = ""
    held: Mapping[str, float] = field(default_factory=dict[str, float])
    free: tuple[str, ...] = ()
    driver: str = ""
    is_default: bool = False
    in_units: bool = True

    def parameters(self, effect: "type[AbstractEffect]") -> dict[str, Parameter]:
        """The free parameters of an effect in this form, by name."""
        return {
            name: known
            for name, known in parameters_of(effect).items()
            if name in self.free or not (known.shapes or name in self.held)
        }

    def physical(self, effect: "type[AbstractEffect]") -> dict[str, Parameter]:
        """The parameters with a physical unit, by the name of their physical form.

        The result is empty for another driver than the default one, because the units belong to the default driver.
        """
        if self.driver or not self.in_units:
            return {}
        return {p.physical.name: p for p in self.parameters(effect).values() if p.physical is not None}

    @property
    def label(self) -> str:
        """Its name, with its driver if that is not the default one."""
        return f"{self.name or 'standard'} of {self.driver}" if self.driver else self.name


class AbstractEffect(eqx.Module):
    """A physical effect.  Its declarations allow a diagnosis to select candidates without knowing their names.

    A subclass is final, declares its parameters as fields (`hsed_jax.physics.parameters.parameter`) and returns its
    contributions to named slots.  Contributions of several effects to one slot are multiplied or added, so the order of effects
    does not matter.  At the neutral values of its parameters, an effect contributes exactly nothing.

    Attributes:
        name: its name in studies and reports.
        family: the kind of physics.
        reference: its source.
        negative: its name if the amplitude is negative, in case `name` says the opposite.
        place: spring, structure or test rig.
        needs_time: whether it depends on rates or time.  A test without a time scale cannot show such an effect.
        histories_only: whether it changes channels but no quantity.
        ground_only: whether it requires a ground motion.
        shaken_only: whether it has no meaning in a component test; it then contributes nothing there.
        forms: its formulas, the default one first; empty if it has only one.
        drivers: its possible drivers, the default one first; empty if there is no choice.
        registered: whether it belongs to a catalogue (`register`).
    """

    name: ClassVar[str]
    family: ClassVar[str]
    reference: ClassVar[str]
    negative: ClassVar[str] = ""
    place: ClassVar[Literal["spring", "structure", "test rig"]]
    needs_time: ClassVar[bool] = False
    histories_only: ClassVar[bool] = False
    shaken_only: ClassVar[bool] = False
    ground_only: ClassVar[bool] = False
    forms: ClassVar[tuple[Form, ...]] = ()
    drivers: ClassVar[tuple[str, ...]] = ()
    registered: ClassVar[bool] = False


class AbstractSpringEffect(AbstractEffect):
    """An effect in the spring; it writes to slots of the law (`hsed_jax.physics.laws`) or adds a force in parallel.

    Slots: factors on `a`, `nu`, `eta`, `h`; addends to `force` [N], to `n`, to `gamma` (in units of β), to `compliance` (of
    a spring in series with the element [m/N]), to `plastic` (the plastic elongation of a linear spring [m]) and to `slack` (the
    elongation without force on each side [m]).  Every law has `force` and `slack`, and declares which other slots it has.

    Attributes:
        needs: states of the spring that it reads, in addition to force and energy (`hsed_jax.physics.states`).  Effects that need
            the same state share it.
        states: names of its own states, zero in a virgin spring.  `flow` gives their rates, or a step commits them.
        linear_only: whether it applies to linear springs only, because all other laws include it already.
    """

    place: ClassVar[Literal["spring", "structure", "test rig"]] = "spring"
    linear_only: ClassVar[bool] = False

    @property
    def states(self) -> tuple[str, ...]:
        """No further states by default."""
        return ()

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """No further states by default."""
        return ()

    @abstractmethod
    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """Contributions by slot."""

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """Time derivatives of its own states, by name."""
        del point
        return {}

    def settle(self, point: SpringPoint) -> dict[str, Scalar]:
        """The own states that a step commits, by name, at the end of a step or at a reversal inside it."""
        del point
        return {}


class AbstractSetupEffect(AbstractEffect):
    """An effect outside the spring: in the structure, or in the test rig.

    Slots: factors on `mass` (one per mass, shape (masses,)), on `support` (one per spring that goes to the ground, in order,
    shape (supports,)), on `damping` (all of C), on `ground_motion`, and on the measured force and elongation (`force_gain`,
    `elongation_gain`); addends `force_offset` [N], `settling_offset` [N] and `settling_rate` [1/s] (an offset that vanishes),
    `force_drift` [N/s], `drift_onset` [s] (when that begins) and `drift_slowing` [1/s], `elongation_delay` [s] and
    `force_delay` [s] (by how much the measured signal is late; `hsed_jax.physics.sensors`).
    """

    @abstractmethod
    def contribute(self, setup: Setup) -> dict[str, Any]:
        """Contributions by slot."""


@final
@dataclass(frozen=True)
class Catalogue(Mapping[str, type[AbstractEffect]]):
    """Effects by name, in order.  If there are several specimens, the name begins with the specimen, such as `storey2.slip`.

    A catalogue never changes.  Compiled programs are identified by it, so effects of two studies may have the same name.

    Attributes:
        entries: names and classes.

    Raises:
        ValueError: two effects have the same name, or one has the name of the structure.
    """

    entries: tuple[tuple[str, type[AbstractEffect]], ...] = ()

    def __post_init__(self):
        """Refuse duplicate names."""
        names = [name for name, _ in self.entries]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"two effects are named {twice[0]!r}")
        if OWNER in names:
            raise ValueError(f"no effect can be named {OWNER!r}, which stands before the numbers of the structure")

    @classmethod
    def of(cls, effects: Iterable[type[AbstractEffect]]) -> "Catalogue":
        """The catalogue of effects by their own names."""
        return cls(tuple((effect.name, effect) for effect in effects))

    @cached_property
    def _by_name(self) -> dict[str, type[AbstractEffect]]:
        return dict(self.entries)

    def __getitem__(self, name: str) -> type[AbstractEffect]:
        """The effect of this name."""
        return self._by_name[name]

    def __iter__(self) -> Iterator[str]:
        """The names."""
        return iter(self._by_name)

    def __len__(self) -> int:
        """The number of effects."""
        return len(self.entries)

    def only(self, names: Iterable[str]) -> "Catalogue":
        """The catalogue of these effects alone, in this order."""
        return Catalogue(tuple((name, self[name]) for name in names))

    def joined(self, effects: Iterable[type[AbstractEffect]]) -> "Catalogue":
        """The catalogue with further effects at its end."""
        return Catalogue((*self.entries, *Catalogue.of(effects).entries))


def neutral(slot: str) -> float:
    """The neutral value of a slot, if no effect writes to it."""
    return 1.0 if slot in MULTIPLIED else 0.0


def merged(contributions: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Merge contributions of several effects: slot name -> product or sum."""
    found: dict[str, Any] = {}
    for contribution in contributions:
        for slot, value in contribution.items():
            if slot in MULTIPLIED:
                found[slot] = found[slot] * value if slot in found else value
            elif slot in ADDED:
                found[slot] = found[slot] + value if slot in found else value
            else:
                raise ValueError(f"There is no slot {slot!r}; slots are {', '.join((*MULTIPLIED, *ADDED))}.")
    return found


def combine(contributions: Iterable[Mapping[str, Any]]) -> Callable[[str], Any]:
    """Merge contributions: slot name -> value.

    A slot without a contribution has its neutral Python number, which XLA folds away.
    """
    found = merged(contributions)
    return lambda slot: found.get(slot, neutral(slot))
