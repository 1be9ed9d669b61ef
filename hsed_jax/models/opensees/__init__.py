"""Materials of OpenSees as models of a component test: the table of materials, and the processes that run them."""

from hsed_jax.models.opensees.base import AbstractMaterial
from hsed_jax.models.opensees.hysteretic_sm import HystereticSM
from hsed_jax.models.opensees.imk import IMKBilin, IMKPeakOriented, IMKPinching
from hsed_jax.models.opensees.pinching4 import Pinching4
from hsed_jax.models.opensees.saws import SAWS
from hsed_jax.models.opensees.self_centering import SelfCentering
from hsed_jax.models.opensees.steel4 import Steel4

_ALL = (Pinching4, IMKPeakOriented, IMKPinching, IMKBilin, HystereticSM, SelfCentering, Steel4, SAWS)
MATERIALS: dict[str, type[AbstractMaterial]] = {material.name: material for material in _ALL}
"""The materials by the names of OpenSees."""
