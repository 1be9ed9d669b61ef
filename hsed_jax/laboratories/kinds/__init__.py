"""The laboratories that a study may name (`experiments`), one file each.

`base.py` has the interface of laboratories.  Reading a study needs no JAX, so a file imports the laboratory itself only in
the method that makes it.
"""

from hsed_jax.laboratories.kinds.base import AbstractLaboratoryEntry
from hsed_jax.registry import Parts

KINDS: Parts[AbstractLaboratoryEntry] = Parts(__name__, "laboratory")
"""The sections of the laboratories by their keys in a study."""
