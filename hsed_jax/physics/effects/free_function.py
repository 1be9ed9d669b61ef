r"""A free function at any place, for behaviour that no formula of the catalogue describes.

$$f(\xi_1,\xi_2)=\sum_{j,k} c_{jk}\,T_j(\xi_1)\,T_k(\xi_2)=\sum_{m,n} p_{mn}\,\xi_1^m\,\xi_2^n$$

f has one or two coordinates, each scaled to its reach, $-1\le\xi\le 1$, and clipped beyond.  T are the polynomials of Chebyshev.
Since $T_j(\cos\theta)=\cos j\theta$, f is a draw of a stationary process in θ if the coefficients are normal and their standard
deviations are the roots of its spectral density.  The effect takes the coefficients of powers, because their sum compiles to one
loop and the recurrences of the polynomials to fifty.  It adds $F_c f$ to the force, or multiplies a slot by $e^f$.  Parameters
select the coordinates and the slot, so one compiled program serves all places.
"""

import math
from collections.abc import Iterable
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hsed_jax.physics.effects.base import AbstractSpringEffect, SpringPoint
from hsed_jax.physics.effects.coordinates import COORDINATES, fading, needs_of, states_of
from hsed_jax.physics.parameters import parameter
from hsed_jax.physics.scales import Scalar
from hsed_jax.physics.states import SharedState

COUNTS = (18, 8, 8, 8)
"""Number of polynomials in the first coordinate, for each polynomial in the second."""
SLOTS = ("force", "a", "nu", "h")
"""The slots of a free function."""
# A factor stays within e^±3.
_FARTHEST = 3.0
_NAMES = tuple(COORDINATES)


def power(m: int, n: int = 0) -> str:
    """The name of the coefficient of two powers."""
    return f"p_{m}_{n}"


DEGREES = tuple((m, n) for n, count in enumerate(COUNTS) for m in range(count))
"""The degrees of the polynomials, and of the powers, of a free function."""
POWERS = tuple(power(m, n) for m, n in DEGREES)
"""The names of their coefficients."""


def powers_of(coefficients: Float[np.ndarray, "... m"]) -> Float[np.ndarray, "... m"]:
    """Coefficients of powers from those of polynomials, both in the order of `DEGREES`."""
    return coefficients @ _TO_POWERS.T


def deviations(length: float, size: float, count: int) -> np.ndarray:
    r"""Standard deviations of the coefficients, (count,), of a process in θ = arccos ξ with this length and size.

    Matérn 5/2: $\propto\sqrt{1+[j>0]}\,(5/\ell^2+j^2)^{-3/2}$, scaled so that the mean deviation of f over θ is the size.
    """
    shape = (5 / length**2 + np.arange(count) ** 2.0) ** -1.5
    # A frequency stands for itself and its negative.
    shape[1:] *= math.sqrt(2)
    # Half of the variance of a cosine is lost on average, all of a constant kept.
    return size * shape / math.sqrt(shape[0] ** 2 + 0.5 * float(np.sum(shape[1:] ** 2)))


def _powers(count: int) -> np.ndarray:
    """Coefficients of powers, by degree, of the polynomials, (count, count): the matrix that turns c into those of f."""
    made = np.zeros((count, count))
    for j in range(count):
        own = np.polynomial.chebyshev.cheb2poly([*[0.0] * j, 1.0])
        made[: len(own), j] = own
    return made


_ONE = _powers(COUNTS[0])
_TO_POWERS = np.asarray([[_ONE[m, j] * _ONE[n, k] for j, k in DEGREES] for m, n in DEGREES])


class AbstractFreeFunction(AbstractSpringEffect):
    """A free function.

    Attributes:
        slots: the slots of its law to which it may write.
    """

    family: ClassVar[str] = "learned"
    reference: ClassVar[str] = "Rasmussen & Williams 2006, section 4.2; Boyd 2001, chapter 2"
    place: ClassVar[Literal["spring", "structure", "test rig"]] = "spring"
    slots: ClassVar[tuple[str, ...]] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """The states of the coordinates that fade."""
        return states_of(_NAMES)

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The states that the coordinates need."""
        return needs_of(_NAMES)

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """Rates of the states that fade."""
        return fading(_NAMES, point, self._number("fade"))

    def value(self, point: SpringPoint) -> Scalar:
        """f at one instant."""
        given = {name: known.value(point) for name, known in COORDINATES.items()}
        xi: list[Scalar] = []
        for number in (1, 2):
            mixed = _sum(self._number(f"of_{name}_{number}") * value for name, value in given.items())
            over = (mixed - self._number(f"middle_{number}")) / self._number(f"half_{number}")
            xi.append(jnp.clip(over, -1.0, 1.0))
        found: Scalar = 0.0
        for n, count in reversed(list(enumerate(COUNTS))):
            along: Scalar = 0.0
            for m in reversed(range(count)):
                along = along * xi[0] + self._number(power(m, n))
            found = found * xi[1] + along
        return found

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`, or a factor on another slot."""
        f = self.value(point)
        factors = {
            slot: jnp.exp(jnp.clip(self._number(f"in_{slot}") * f, -_FARTHEST, _FARTHEST)) for slot in self.slots[1:]
        }
        return {"force": self._number("in_force") * point.scales.force * f, **factors}

    def _number(self, name: str) -> Scalar:
        return getattr(self, name)


def _sum(terms: Iterable[Any]) -> Any:
    found = None
    for term in terms:
        found = term if found is None else found + term
    return found


def _declared(name: str, title: str, slots: tuple[str, ...]) -> type[AbstractFreeFunction]:
    """Make the class of the effect with these slots, with its parameters as fields."""
    one: dict[str, Any] = {"prior": {"normal": [0.0, 1.0]}}
    numbers = {f"in_{slot}": (0.0, f"share of the slot {slot}") for slot in slots}
    for number in (1, 2):
        numbers |= {f"of_{c}_{number}": (0.0, f"share of {COORDINATES[c].words}") for c in _NAMES}
        numbers[f"middle_{number}"] = (0.0, "middle of the reach of a coordinate")
        numbers[f"half_{number}"] = (1.0, "half the reach of a coordinate")
    numbers["fade"] = (1.0, "time in which what fades does so, over u_c/v_c")
    numbers |= dict.fromkeys(POWERS, (0.0, "coefficient of two powers"))
    fields = {key: parameter(key, "1", words, neutral=neutral, **one) for key, (neutral, words) in numbers.items()}
    space = {
        "__doc__": f"{title}: a free function of one or two coordinates at one of the slots {', '.join(slots)}.",
        "__module__": __name__,
        "__qualname__": name,
        "__annotations__": dict.fromkeys(fields, Scalar) | {"name": ClassVar[str], "slots": ClassVar[tuple[str, ...]]},
        "name": "learned",
        "slots": slots,
        **fields,
    }
    metaclass: Any = type(eqx.Module)
    return metaclass(name, (AbstractFreeFunction,), space)


FreeFunction = _declared("FreeFunction", "A free function in a law with inner slots", SLOTS)
FreeForce = _declared("FreeForce", "A free force beside any law", SLOTS[:1])
