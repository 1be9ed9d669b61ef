"""The samplers that a study may name (`calibration.sampler`), one file each.

`base.py` has the interface of samplers. A file is executed at the first use of its sampler.
"""

from typing import TYPE_CHECKING

from hsed_jax.registry import Parts

if TYPE_CHECKING:
    # A wrong name is refused before JAX is loaded.
    from hsed_jax.inference.samplers.base import AbstractSampler

SAMPLERS: "Parts[AbstractSampler]" = Parts(__name__, "sampler")
"""The samplers by their names."""
