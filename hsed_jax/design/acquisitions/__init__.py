"""The acquisitions that a study may name (`design.acquisition`), one file each.

`base.py` has the interface of acquisitions. A file is executed at the first use of its acquisition.
"""

from typing import TYPE_CHECKING

from hsed_jax.registry import Parts

if TYPE_CHECKING:
    # A wrong name is refused before JAX is loaded.
    from hsed_jax.design.acquisitions.base import AbstractAcquisition

ACQUISITIONS: "Parts[AbstractAcquisition]" = Parts(__name__, "acquisition")
"""The acquisitions by their names."""
