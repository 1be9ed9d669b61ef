"""The samplers that a study may name (`calibration.sampler`), one file each.

`base.py` says what a sampler has.  No file is executed before its sampler is asked to draw.
"""

from typing import TYPE_CHECKING

from hsed_jax.registry import Parts

if TYPE_CHECKING:
    # A wrong name is refused before JAX is loaded.
    from hsed_jax.inference.samplers.base import AbstractSampler

SAMPLERS: "Parts[AbstractSampler]" = Parts(__name__, "sampler")
"""The samplers by their names."""
