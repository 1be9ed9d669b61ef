"""The declaration of a parameter, written once.

Schema, priors, axis labels, `hsed effects` and the tables of the documentation are all read from here.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx

from hsed_jax.physics.scales import Scalar, Scales

_KEY = "parameter"


@dataclasses.dataclass(frozen=True)
class PhysicalForm:
    """The same parameter in SI units: physical = dimensionless × factor(scales)."""

    name: str
    unit: str
    factor: Callable[[Scales], Scalar]


@dataclasses.dataclass(frozen=True)
class Parameter:
    """Metadata of one parameter.

    Attributes:
        name: as in studies and results.
        symbol: LaTeX, for axis labels.
        unit: SI unit, or "1".
        meaning: one line.
        neutral: the value at which the parameter changes nothing (effects), or its default (laws); None: must be given.
        lower, upper: physical bounds.
        prior: default prior as in a study, e.g. {"half_normal": 1.0}; None: must be given.
        physical: its other, dimensional form, if it has one.
        shapes: it belongs to forms of an effect (`hsed_jax.physics.effects.forms`); it is neutral in the other forms.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    neutral: float | None = None
    lower: float = -float("inf")
    upper: float = float("inf")
    prior: Mapping[str, Any] | None = None
    physical: PhysicalForm | None = None
    shapes: bool = False


def parameter(symbol: str, unit: str, meaning: str, **details: Any) -> Any:
    """A field of an `eqx.Module` that is a parameter; its name is filled in by `parameters_of`."""
    metadata = {_KEY: Parameter(name="", symbol=symbol, unit=unit, meaning=meaning, **details)}
    neutral = details.get("neutral")
    return eqx.field(metadata=metadata) if neutral is None else eqx.field(default=neutral, metadata=metadata)


def parameters_of(module: Any) -> dict[str, Parameter]:
    """The parameters a class (or an instance of it) declares, by name, in order; those of its forms last."""
    known = {
        field.name: dataclasses.replace(field.metadata[_KEY], name=field.name)
        for field in dataclasses.fields(module)
        if _KEY in field.metadata
    }
    return dict(sorted(known.items(), key=lambda item: item[1].shapes))


def shape_parameter(symbol: str, meaning: str, **details: Any) -> Any:
    """A dimensionless field that distinguishes forms of an effect."""
    return parameter(symbol, "1", meaning, shapes=True, **details)


def share_parameter(symbol: str, meaning: str, neutral: float = 0.0) -> Any:
    """A shape parameter from none to all of something; forms hold it at zero or one."""
    return shape_parameter(symbol, meaning, neutral=neutral, lower=0.0, upper=1.0, prior={"uniform": [0.0, 1.0]})


def dimensionless(module: Any, name: str, value: Any, scales: Scales) -> dict[str, Any]:
    """A parameter of an effect under its dimensionless name, from either of its forms.

    Raises:
        KeyError: the effect has no such parameter.
    """
    for known in parameters_of(module).values():
        if name == known.name:
            return {name: value}
        if known.physical is not None and name == known.physical.name:
            return {known.name: value / known.physical.factor(scales)}
    raise KeyError(name)
