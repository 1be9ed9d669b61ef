"""The excitations that a study may name, one file each, called like its key; `hsed_jax.physics.declared` has their settings."""

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
from hsed_jax.registry import Parts

EXCITATIONS = Parts[AbstractExcitation](__name__, "excitation")
"""The classes that compute them, by the keys of a study."""
