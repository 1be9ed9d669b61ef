"""Which effects there are, where each can show, and the register of their formulas."""

from collections.abc import Callable
from dataclasses import dataclass, field

from .specimen import Scales

EFFECTS = {
    "stiffness_degradation": "stiffness",
    "strength_degradation": "strength",
    "pinching": "pinching",
    "slip": "pinching",
    "peak_softening": "stiffness",
    "asymmetry": "asymmetry",
    "yield_sharpness": "hysteresis",
    "loop_shape": "hysteresis",
    "hardening": "post-yield",
    "cubic_stiffness": "post-yield",
    "quadratic_stiffness": "asymmetry",
    "isotropic_hardening": "hardening",
    "viscous_damping": "damping",
    "quadratic_damping": "damping",
    "power_damping": "damping",
    "coulomb_friction": "friction",
    "stribeck_friction": "friction",
    "gap": "contact",
    "contact_stiffening": "contact",
    "rate_dependence": "rate",
    "relaxation": "rate",
    "fracture": "strength",
    "damping_error": "structure",
    "mass_error": "structure",
    "support_stiffness_error": "structure",
    "support_flexibility": "structure",
    "ground_motion_gain": "test rig",
    "actuator_delay": "test rig",
    "force_gain": "test rig",
    "elongation_gain": "test rig",
    "force_offset": "test rig",
    "force_drift": "test rig",
    "time_offset": "test rig",
}
# What tests of real specimens show beside them; groups of their own, so that the cases of the others stay as they are.
REAL = {
    "self_centering": "recentring",
    "kinematic_hardening": "hardening",
    "peak_oriented": "stiffness",
    "buckling": "asymmetry",
    "scragging": "stiffness",
}
FAMILIES = EFFECTS | REAL
SHAKEN_ONLY = {"damping_error", "mass_error", "support_stiffness_error", "ground_motion_gain"}
HISTORIES_ONLY = {"actuator_delay", "force_offset", "force_drift", "time_offset"}
KINDS = ("shaken", "component", "quantities")


def applicable(effect: str, kind: str) -> bool:
    """Whether an effect can be hidden in a campaign of this kind."""
    if effect not in FAMILIES or kind not in KINDS:
        raise ValueError(f"no effect {effect!r} or no kind {kind!r}; kinds are {', '.join(KINDS)}")
    return not ((kind == "component" and effect in SHAKEN_ONLY) or (kind == "quantities" and effect in HISTORIES_ONLY))


@dataclass(frozen=True)
class Formula:
    """One formula of an effect.

    Attributes:
        place: `specimen`, `frame`, `sensor` or `opensees`.
        act: the function; its signature depends on the place.
        largest: cap of the amplitude δ.
        physical: name and SI unit of the amplitude in physical form, and its value for δ = 1.
        draws: range of every further parameter.
        also: physical form of further parameters: name -> (name, SI unit, value of one).
        states: extra states of the specimen.
        is_signed: whether δ may be negative too (drawn).
        drive: for component tests, what becomes of the imposed motion: (program, δ) -> program.
    """

    place: str
    act: Callable
    largest: float
    physical: tuple[str, str, Callable[[Scales], float]] = ("delta", "1", lambda _: 1.0)
    draws: dict[str, tuple[float, float]] = field(default_factory=dict)
    also: dict[str, tuple[str, str, Callable[[Scales], float]]] = field(default_factory=dict)
    states: int = 0
    is_signed: bool = False
    drive: Callable | None = None


FORMULAS: dict[tuple[str, str], Formula] = {}

STIFFNESS = ("k", "N/m", lambda c: c.force / c.elongation)
FORCE = ("force", "N", lambda c: c.force)
OFFSET = ("offset", "N", lambda c: c.force)
VISCOUS = ("c", "N*s/m", lambda c: c.force / c.rate)
PER_ENERGY = ("eta", "1/J", lambda c: 1 / c.energy)
TIME = ("tau", "s", lambda c: c.elongation / c.rate)


def add(effect: str, formula: str, act: Callable, largest: float, physical=None, place="specimen", **more) -> None:
    if physical is not None:
        more["physical"] = physical
    FORMULAS[effect, formula] = Formula(place, act, largest, **more)


def formula(effect: str, name: str) -> Formula:
    """The formula of an effect; a clear error where there is none."""
    if (effect, name) not in FORMULAS:
        known = [f for e, f in FORMULAS if e == effect]
        raise ValueError(f"{effect!r} has no formula {name!r}; it has {', '.join(known) or 'none'}")
    return FORMULAS[effect, name]
