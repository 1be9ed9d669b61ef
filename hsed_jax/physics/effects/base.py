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
    r"""What an effect may look at: the spring at one instant.

    Attributes:
        elongation: Δu [m].
        rate: Δu̇ [m/s].
        hysteretic: z [N], the force of the law's element; of a law of paths, slots other than `force` see that of its last
            commit.
        memory: further states by name, among them `energy` e [J].
        scales: characteristic values.
        strength: force at which the virgin element yields, or its bound, $[A/(\beta+\gamma)]^{1/n}$ of Bouc–Wen [N]; of a law
            without one what stands for it (`AbstractSpringLaw.yardstick`).
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
    """What an effect outside the spring may look at.

    Attributes:
        scales: characteristic values.
        masses: number of masses of the structure (none in a component test).
        supports: number of its springs that go to the ground.
    """

    scales: Scales
    masses: int
    supports: int


@dataclass(frozen=True)
class Form:
    """One formula of an effect.

    Attributes:
        name: as in studies and reports, within the effect; empty where an effect has but one formula.
        equation: LaTeX; empty where the effect's own description has it.
        reference: where it comes from; empty where it is the effect's.
        held: parameters that it holds, and at what.
        free: shape parameters that it leaves free, besides those that the effect has in every form.
        driver: what drives it; empty where there is no choice.
        is_default: it is what a study means that names no form.
        in_units: its numbers may be given in SI units, too; not where the unit would change with the shape.
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
        """What is free of an effect in this form."""
        return {
            name: known
            for name, known in parameters_of(effect).items()
            if name in self.free or not (known.shapes or name in self.held)
        }

    def physical(self, effect: "type[AbstractEffect]") -> dict[str, Parameter]:
        """What of it has a physical form, by the name of that; nothing with another driver, as they are per the first one."""
        if self.driver or not self.in_units:
            return {}
        return {p.physical.name: p for p in self.parameters(effect).values() if p.physical is not None}

    @property
    def label(self) -> str:
        """Name with its driver, where that is not the default one."""
        return f"{self.name or 'standard'} of {self.driver}" if self.driver else self.name


class AbstractEffect(eqx.Module):
    """A physical effect: what every kind of it declares, so that a diagnosis selects candidates without knowing names.

    A subclass is final, declares its parameters as fields (`hsed_jax.physics.parameters.parameter`) and returns its
    contributions to named slots.  Contributions of several effects to one slot multiply (or add), so effects commute.  At the
    neutral value of its parameters an effect contributes exactly nothing.

    Attributes:
        name: as it stands in studies and reports.
        family: the kind of physics.
        reference: where it comes from.
        negative: what it is where its amplitude is negative, if its name says the contrary.
        place: where the physics sits.
        needs_time: it depends on rates or on time, not on the path alone: a test without a time scale cannot show it.
        histories_only: it changes channels but no quantity.
        ground_only: it means nothing where the ground rests.
        shaken_only: it means nothing in a component test, and does nothing there.
        forms: its formulas, the default one first; none where it has but one.
        drivers: what may drive it, the default one first; none where there is no choice.
        registered: it is for a catalogue; `register` says so.
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
    """An effect in the spring, at the slots of its law (`hsed_jax.physics.laws`) or beside it.

    Slots: factors on `a`, `nu`, `eta`, `h`; addends to `force` [N], to `n`, to `gamma` (in units of β), to `compliance` (of
    what is in series with the element [m/N]), to `plastic` (the elongation that a linear spring does not feel [m]) and to `slack`
    (the elongation without force to either side [m]).  Every law has `force` and `slack`; which of the others, it says.

    Attributes:
        needs: states of the spring that it looks at besides force and energy (`hsed_jax.physics.states`); two effects that need
            one state share it.
        states: names of states of its own, zero in a virgin spring; their rates are its `flow`, or a step commits them.
        linear_only: it is what a spring that is not linear has already.
    """

    place: ClassVar[Literal["spring", "structure", "test rig"]] = "spring"
    linear_only: ClassVar[bool] = False

    @property
    def states(self) -> tuple[str, ...]:
        """None, unless a subclass says so."""
        return ()

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """None, unless a subclass says so."""
        return ()

    @abstractmethod
    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """Contributions by slot."""

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """Time derivatives of its own states, by name."""
        del point
        return {}

    def settle(self, point: SpringPoint) -> dict[str, Scalar]:
        """Its own states that a step commits, by name, after one that came to this point, or turned there."""
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
    """Effects by name, in order; that of one of several specimens has its place in front, as `storey2.slip`.

    A value: it never changes, and a compiled program is known by it, so that effects of two studies may share a name.

    Attributes:
        entries: names and classes.

    Raises:
        ValueError: two of them have one name, or one has that of the structure.
    """

    entries: tuple[tuple[str, type[AbstractEffect]], ...] = ()

    def __post_init__(self):
        """Refuse a name that stands twice."""
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
        """How many there are."""
        return len(self.entries)

    def only(self, names: Iterable[str]) -> "Catalogue":
        """The catalogue of these effects alone, in this order."""
        return Catalogue(tuple((name, self[name]) for name in names))

    def joined(self, effects: Iterable[type[AbstractEffect]]) -> "Catalogue":
        """The catalogue with further effects at its end."""
        return Catalogue((*self.entries, *Catalogue.of(effects).entries))


def neutral(slot: str) -> float:
    """What stands in a slot that nobody writes to."""
    return 1.0 if slot in MULTIPLIED else 0.0


def merged(contributions: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Contributions as one: slot name -> product or sum."""
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
    """Merge contributions: slot name -> value, or the neutral Python number where nobody wrote (and XLA folds it away)."""
    found = merged(contributions)
    return lambda slot: found.get(slot, neutral(slot))
