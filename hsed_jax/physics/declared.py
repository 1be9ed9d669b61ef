"""Declarations without computations: spring laws by name, excitations with their settings.

Nothing here needs JAX, which takes longer to load than a study takes to read: a wrong key is reported without it.  An
excitation is declared here, and computed by the class in the file of `hsed_jax.physics.excitations` with its name.  Studies,
laboratories, figures and reports use these declarations.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from hsed_jax.errors import UserError
from hsed_jax.physics.protocols import PROTOCOLS
from hsed_jax.registry import Parts

if TYPE_CHECKING:
    from hsed_jax.physics.laws.base import AbstractSpringLaw

LAWS: "Parts[AbstractSpringLaw]" = Parts("hsed_jax.physics.laws", "spring law", ("base", "reversal"))
"""The spring laws that come with the package by their names, one file each; a study may bring its own."""


class Kind(NamedTuple):
    """The kind of an excitation.

    Attributes:
        protocol: of a campaign of such experiments.
        channel: that measures it, in terms of the settings.
        file: that a laboratory is given, without its ending.
        column: of that file.
        noun: for reports and figures.
    """

    protocol: Literal["ground_motion", "displacement"]
    channel: str
    file: str
    column: str
    noun: str

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files for a laboratory."""
        return tuple(f"{self.file}.{ending}" for ending in ("csv", *(("AT2",) if self.file == "ground_motion" else ())))


GROUND_MOTION = Kind("ground_motion", "ground_acceleration", "ground_motion", "ag", "ground motion")
APPLIED_FORCE = Kind("ground_motion", "applied_force_{mass}", "applied_force", "p", "applied force")
IMPOSED_ELONGATION = Kind("displacement", "elongation", "imposed_elongation", "du", "imposed elongation")


@dataclass(frozen=True)
class Setting:
    """A setting of a study.

    Attributes:
        meaning: a noun.
        unit: SI unit, or "1".
        kind: `number`: a number or the name of an input; `numbers`: a list of these; `whole`: a fixed whole number, at least 1;
            `word`: a key of `words`.
        default: None: it must be given, unless `is_optional`.
        is_positive: whether it must be.
        is_optional: whether it may be left out, depending on other settings; it is then None.
        words: meaning of a `word`.
    """

    meaning: str
    unit: str
    kind: Literal["number", "numbers", "whole", "word"] = "number"
    default: float | None = None
    is_positive: bool = False
    is_optional: bool = False
    words: Mapping[str, Any] = field(default_factory=dict[str, Any])


def _all_possible(settings: Mapping[str, Any]) -> tuple[str, str] | None:
    del settings
    return None


@dataclass(frozen=True)
class Declared:
    """The declaration of an excitation.

    Attributes:
        name: its key in a study.
        kind: of the excitation.
        settings: of a study, by the names of its fields.
        sentence: its description without a full stop, from the settings of the study and the duration [s].
        of_file: its fields that are read from a record, the time first: its setting `file`; none of an excitation without one.
        is_endless: whether the study must give the duration.
        impossible: from the settings, the impossible one with the reason; None without one. The values of inputs are unknown
            here.
    """

    name: str
    kind: Kind
    settings: Mapping[str, Setting]
    sentence: Callable[[Mapping[str, Any], float | None], str]
    of_file: tuple[str, ...] = ()
    is_endless: bool = False
    impossible: Callable[[Mapping[str, Any]], tuple[str, str] | None] = _all_possible

    def default(self, name: str) -> Any:
        """The value of a setting that a study does not give."""
        return self.settings[name].default


def _one_oscillation(settings: Mapping[str, Any]) -> tuple[str, str] | None:
    """With one oscillation Eq. 17 has no value."""
    is_one = settings["gamma"] == 1
    return ("gamma", "the number of oscillations is positive and not 1, but it is 1") if is_one else None


def _amplitudes_or_protocol(settings: Mapping[str, Any]) -> tuple[str, str] | None:
    """Amplitudes with their cycles, or a protocol with its reference and steps."""
    given = {name for name, value in settings.items() if value is not None}
    if not given & {"amplitudes", "protocol"}:
        return "amplitudes", f"give amplitudes, or a protocol ({', '.join(PROTOCOLS)}) with its reference"
    if "amplitudes" in given:
        return next(((name, f"leave out amplitudes, or {name}") for name in _OF_PROTOCOLS if name in given), None)
    if "cycles" in given:
        return "cycles", "leave it out: the protocol determines the number of cycles"
    known = PROTOCOLS[settings["protocol"]]
    if "reference" not in given:
        return "reference", f"this key is required with a protocol; amplitudes are relative to it: {known.relative_to}"
    try:
        known.steps(settings["steps"])
    except UserError as fault:
        return "steps", str(fault)
    return None


_OF_PROTOCOLS = ("protocol", "reference", "steps")


def _of_cycles(settings: Mapping[str, Any], duration: float | None) -> str:
    rate = f"the rate at most {_told(settings['rate'])} m/s"
    if name := settings.get("protocol"):
        known = PROTOCOLS[name]
        extent = f"{known.extent(settings.get('steps'))} times the reference {_told(settings['reference'])} m"
        return f"Elongation imposed by the loading protocol {known.title}: {extent}, {rate}"
    amplitudes = ", ".join(_told(value) for value in settings["amplitudes"])
    cycles = settings.get("cycles") or CYCLES
    return f"{cycles} cycle{'s' if cycles > 1 else ''} of elongation imposed at each amplitude {amplitudes} m, {rate}"


def _told(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _file(settings: Mapping[str, Any]) -> str:
    return settings["file"].rpartition("/")[2]


NEAR_FAULT_PULSE = Declared(
    "near_fault_pulse",
    GROUND_MOTION,
    {
        "V_P": Setting("peak velocity", "m/s"),
        "T_P": Setting("period", "s", is_positive=True),
        "gamma": Setting("number of oscillations", "1", default=2.0, is_positive=True),
        "nu": Setting("phase", "1", default=0.10),
    },
    lambda settings, duration: f"Shaken by near-fault pulses of {duration:g} s",
    is_endless=True,
    impossible=_one_oscillation,
)
RECORDED_MOTION = Declared(
    "recorded",
    GROUND_MOTION,
    {"scale": Setting("factor", "1", default=1.0)},
    lambda settings, duration: f"Shaken by the recorded motion {_file(settings)}",
    of_file=("time", "ground_acceleration"),
)
HISTORY_OF_A_FORCE = Declared(
    "applied_force",
    APPLIED_FORCE,
    {"mass": Setting("number of the mass", "1", kind="whole"), "scale": Setting("factor", "1", default=1.0)},
    lambda settings, duration: f"Driven by the force {_file(settings)} on mass {settings['mass']}, the ground at rest",
    of_file=("time", "force"),
)
CYCLIC_ELONGATION = Declared(
    "imposed",
    IMPOSED_ELONGATION,
    {
        "amplitudes": Setting("amplitude", "m", kind="numbers", is_positive=True, is_optional=True),
        "rate": Setting("rate", "m/s", is_positive=True),
        "cycles": Setting("number of cycles", "1", kind="whole", is_optional=True),
        "protocol": Setting("loading protocol", "1", kind="word", is_optional=True, words=PROTOCOLS),
        "reference": Setting("reference", "m", is_positive=True, is_optional=True),
        "steps": Setting("number of steps", "1", kind="whole", is_optional=True),
    },
    _of_cycles,
    impossible=_amplitudes_or_protocol,
)
CYCLES = 2
"""Full cycles at each amplitude, if a study gives neither them nor a protocol."""

DECLARED = {known.name: known for known in list(globals().values()) if isinstance(known, Declared)}
"""Excitations by their keys in a study."""
