"""Spring laws, one file each; a study chooses one by its name (`model.spring`).

`base.py` has the interface of laws. The registry is in `hsed_jax.physics.declared`, which needs no JAX for the names.
"""

from hsed_jax.physics.declared import LAWS as LAWS
from hsed_jax.physics.laws.base import AbstractSpringLaw as AbstractSpringLaw
from hsed_jax.physics.laws.bouc_wen import BoucWen as BoucWen
from hsed_jax.physics.laws.elastic import Elastic as Elastic
