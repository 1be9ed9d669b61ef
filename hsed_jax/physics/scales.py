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
