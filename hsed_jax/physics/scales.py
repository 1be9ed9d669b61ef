"""Characteristic values that make amplitudes dimensionless."""

from typing import NamedTuple


class Scales(NamedTuple):
    """Characteristic force F_c [N], elongation u_c [m], elongation rate v_c [m/s] and absorbed energy E_c [J]."""

    force: float = 1.0
    elongation: float = 1.0
    rate: float = 1.0
    energy: float = 1.0
