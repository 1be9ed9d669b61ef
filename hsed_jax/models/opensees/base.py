"""The base of every material of OpenSees in the table: parameters with units and priors, and the arguments in OpenSees' order.

A material has few free parameters and is symmetric unless its parameter `negative` is free.  A parameter of degradation is
zero without degradation, and its prior has its maximum there.

Priors of parameters with units come from the record: `Scaled` gives the mark of the record in their middle.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

Arguments = tuple[float | int | str, ...]


class Marks(NamedTuple):
    """Characteristic points of a specimen from the records of a campaign, SI of its pair; NaN if unknown.

    Attributes:
        stiffness: initial stiffness [N/m].
        force: largest force [N].
        elongation: largest elongation [m].
        path: absorbed energy over the largest force [m].
    """

    stiffness: float
    force: float
    elongation: float
    path: float


NOTHING = Marks(math.nan, math.nan, math.nan, math.nan)
"""The marks without a record."""


@dataclass(frozen=True)
class Scaled:
    """A prior in units of a mark of the record.

    Attributes:
        mark: field of `Marks`.
        factor: the middle of the prior over the mark, or the scale of a half-normal one times the mark.
        spread: standard deviation of the logarithm.
        inverse: whether the prior is half-normal with the scale factor/mark, for a rate of degradation.
    """

    mark: str
    factor: float
    spread: float = 0.0
    inverse: bool = False

    def prior(self, marks: Marks) -> dict[str, Any] | None:
        """The prior as in a study; None if the record does not determine the mark."""
        value = float(getattr(marks, self.mark))
        if not (math.isfinite(value) and value > 0):
            return None
        if self.inverse:
            return {"half_normal": self.factor / value}
        return {"lognormal": [math.log(self.factor * value), self.spread]}

    @property
    def words(self) -> str:
        """The prior in words."""
        if self.inverse:
            return f"half-normal, {self.factor:g} over the {self.mark}"
        return f"lognormal, {self.factor:g} times the {self.mark}, {self.spread:g}"


@dataclass(frozen=True)
class MaterialParameter:
    """The declaration of a parameter of a material.

    Attributes:
        symbol: LaTeX.
        unit: in N, m and 1; the pair of the campaign translates it.
        meaning: one line.
        prior: as in a study, or scaled by the record; None: only a prior that the study gives.
        value: its value if the study leaves it out; None: it is free, with the prior.
        lower, upper: bounds of possible values.
    """

    symbol: str
    unit: str
    meaning: str
    prior: Mapping[str, Any] | Scaled | None = None
    value: float | None = None
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def range(self) -> str:
        """The possible range, in words."""
        low, high = (f"{bound:g}" if math.isfinite(bound) else "" for bound in (self.lower, self.upper))
        return " and ".join(filter(None, (low and f"at least {low}", high and f"at most {high}")))

    def prior_of(self, marks: Marks) -> dict[str, Any] | None:
        """The prior for a record, as in a study; None without one, or if the record does not determine it."""
        return (
            self.prior.prior(marks)
            if isinstance(self.prior, Scaled)
            else None
            if self.prior is None
            else dict(self.prior)
        )


class AbstractMaterial(ABC):
    """A uniaxial material of OpenSees; the documentation shows the first line of a subclass.

    Attributes:
        name: of OpenSees.
        reference: its source.
        parameters: by name, in the order of reports.
    """

    name: ClassVar[str]
    reference: ClassVar[str]
    parameters: ClassVar[dict[str, MaterialParameter]]

    @staticmethod
    @abstractmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """The arguments after the tag, in the order of OpenSees.

        Arguments:
            p: all parameters by name, SI.
        """


def stiffness() -> MaterialParameter:
    """The initial stiffness."""
    return MaterialParameter("k", "N/m", "initial stiffness", Scaled("stiffness", 1.0, 0.7), lower=0.0)


def strength(symbol: str, meaning: str, factor: float) -> MaterialParameter:
    """A force whose prior has a share of the largest force as its middle."""
    return MaterialParameter(symbol, "N", meaning, Scaled("force", factor, 0.4), lower=0.0)


def length(symbol: str, meaning: str, factor: float, spread: float = 1.0) -> MaterialParameter:
    """An elongation."""
    return MaterialParameter(symbol, "m", meaning, Scaled("elongation", factor, spread), lower=0.0)


def share(
    symbol: str,
    meaning: str,
    low: float,
    high: float,
    value: float | None = None,
    bounds: tuple[float, float] = (0.0, 1.0),
) -> MaterialParameter:
    """A ratio with a uniform prior."""
    return MaterialParameter(symbol, "1", meaning, {"uniform": [low, high]}, value, *bounds)


def damage(symbol: str, meaning: str, scale: float, value: float | None = None) -> MaterialParameter:
    """A ratio of degradation; zero changes nothing."""
    return MaterialParameter(symbol, "1", meaning, {"half_normal": scale}, value, lower=0.0)


def negative() -> MaterialParameter:
    """The strength of the negative side; as strong as the positive one unless the study frees it."""
    meaning = "strength of the negative side over that of the positive side"
    return MaterialParameter(r"\rho", "1", meaning, {"lognormal": [0.0, 0.3]}, 1.0, lower=0.0)
