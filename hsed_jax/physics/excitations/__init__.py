"""Excitations: one file each, and a line of the registry here."""

from hsed_jax.physics.excitations.applied_force import AppliedForce
from hsed_jax.physics.excitations.base import (
    AbstractExcitation as AbstractExcitation,
)
from hsed_jax.physics.excitations.base import (
    AbstractForcing as AbstractForcing,
)
from hsed_jax.physics.excitations.base import (
    Applied as Applied,
)
from hsed_jax.physics.excitations.base import (
    Imposed as Imposed,
)
from hsed_jax.physics.excitations.base import (
    Shaken as Shaken,
)
from hsed_jax.physics.excitations.base import (
    Tabulated as Tabulated,
)
from hsed_jax.physics.excitations.base import (
    channels_of as channels_of,
)
from hsed_jax.physics.excitations.base import (
    driven as driven,
)
from hsed_jax.physics.excitations.cyclic import CyclicElongation
from hsed_jax.physics.excitations.near_fault_pulse import NearFaultPulse
from hsed_jax.physics.excitations.recorded import RecordedMotion

_ALL: tuple[type[AbstractExcitation], ...] = (NearFaultPulse, RecordedMotion, AppliedForce, CyclicElongation)
EXCITATIONS = {excitation.declared.name: excitation for excitation in _ALL}
"""What computes those that a study may name (`hsed_jax.physics.declared`), by their keys."""
