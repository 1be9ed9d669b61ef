"""Spring laws, one file each; a study chooses one by its name (`model.spring`)."""

from collections.abc import Mapping

from hsed_jax.physics.laws.base import AbstractSpringLaw as AbstractSpringLaw
from hsed_jax.physics.laws.bilinear import Bilinear
from hsed_jax.physics.laws.bouc_wen import BoucWen as BoucWen
from hsed_jax.physics.laws.elastic import Elastic
from hsed_jax.physics.laws.menegotto_pinto import MenegottoPinto
from hsed_jax.physics.laws.takeda import Takeda

LAWS: Mapping[str, type[AbstractSpringLaw]] = {
    law.name: law for law in (BoucWen, Elastic, Bilinear, MenegottoPinto, Takeda)
}
"""The laws that come with the package; a study may bring its own."""
