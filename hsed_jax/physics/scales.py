"""Characteristic values that make amplitudes dimensionless."""

from typing import NamedTuple

from jaxtyping import Array, Float

Scalar = Float[Array, ""] | float


class Scales(NamedTuple):
    """Characteristic force F_c [N], elongation u_c [m], elongation rate v_c [m/s] and absorbed energy E_c [J].

    Python numbers are constants of a compiled program, arrays are inputs of it.
    """

    force: Scalar = 1.0
    elongation: Scalar = 1.0
    rate: Scalar = 1.0
    energy: Scalar = 1.0


def is_number(value: Scalar, number: float) -> bool:
    """Whether a value is this number, known while a program is compiled."""
    return isinstance(value, int | float) and value == number


def is_zero(value: Scalar) -> bool:
    """Whether a value is the number zero, known while a program is compiled."""
    return is_number(value, 0)
