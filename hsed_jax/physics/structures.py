r"""The numerical substructure: masses, linear springs, damping, and the ends of the specimens.

$$M\ddot u + C\dot u + K u + \sum_s b_s\,r_s = -M\,1\,a_g,\qquad \Delta u_s = b_s^\top u$$

with b = +1 at a specimen's second end and −1 at its first (0 for the ground).
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

import re
from collections.abc import Mapping, Sequence
from typing import Any, cast, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from hsed_jax.physics.parameters import Parameter

Scalar = Float[Array, ""] | float
End = int | None


@final
class Spring(eqx.Module):
    """A linear spring between two masses (numbered from 0) or the ground (None), stiffness [N/m]."""

    # Static, because the place of a spring decides which operations are computed; a traced structure must not trace it.
    ends: tuple[End, End] = eqx.field(static=True)
    stiffness: Scalar


@final
class ModalDamping(eqx.Module):
    r"""Modal damping of the structure with the specimen at a given stiffness.

    $C = M^{1/2}\,\Phi\,\mathrm{diag}(2\zeta_i\omega_i)\,\Phi^\top M^{1/2}$ with Φ the modes of $M^{-1/2}KM^{-1/2}$.

    Arguments:
        ratios: damping ratio, one for all modes or one per mode (lowest first).
        specimen_stiffness: stiffness of the specimens while C is formed [N/m], one for all or one per specimen.
    """

    ratios: ArrayLike | tuple[Scalar, ...]
    specimen_stiffness: Scalar | tuple[Scalar, ...] = 0.0

    def matrix(self, masses: Float[Array, " m"], stiffness: Float[Array, "m m"]) -> Float[Array, "m m"]:
        """C [N·s/m] from the masses [kg] and the stiffness matrix with the specimen [N/m]."""
        root = jnp.sqrt(masses)
        eigenvalues, modes = _eigen(stiffness / jnp.outer(root, root))
        is_rigid = _is_rigid(eigenvalues)
        circular = jnp.where(is_rigid, 0.0, jnp.sqrt(jnp.where(is_rigid, 1.0, eigenvalues)))
        modal = 2 * jnp.asarray(self.ratios) * circular
        return jnp.outer(root, root) * ((modes * modal) @ modes.T)

    def told(self, values: Mapping[str, Scalar]) -> "ModalDamping":
        """The damping with some of its ratios replaced, by name."""
        if "ratio" in values:
            return ModalDamping(values["ratio"], self.specimen_stiffness)
        if not any(name.startswith("ratio_") for name in values):
            return self
        own = tuple(jnp.asarray(self.ratios))
        ratios = jnp.stack([jnp.asarray(values.get(f"ratio_{i + 1}", ratio)) for i, ratio in enumerate(own)])
        return ModalDamping(ratios, self.specimen_stiffness)


@final
class RayleighDamping(eqx.Module):
    """Rayleigh damping C = α M + β K, with α [1/s], β [s] and the specimens in K at `specimen_stiffness` [N/m]."""

    alpha: Scalar
    beta: Scalar
    specimen_stiffness: Scalar | tuple[Scalar, ...] = 0.0

    def matrix(self, masses: Float[Array, " m"], stiffness: Float[Array, "m m"]) -> Float[Array, "m m"]:
        """C [N·s/m] from the masses [kg] and the stiffness matrix with the specimen [N/m]."""
        return self.alpha * jnp.diag(masses) + self.beta * stiffness

    def told(self, values: Mapping[str, Scalar]) -> "RayleighDamping":
        """The damping with α, β or both replaced, by name."""
        alpha, beta = values.get("alpha", self.alpha), values.get("beta", self.beta)
        return RayleighDamping(alpha, beta, self.specimen_stiffness)


@final
class Structure(eqx.Module):
    """Masses, springs, damping and the places of the specimens.

    Arguments:
        masses: [kg], shape (m,).
        springs: linear springs.
        specimens: the two ends of each; its elongation is the displacement of the second minus that of the first.
        damping: a damping model.

    Raises:
        ValueError: an end is not a mass, both ends of a spring or specimen are equal, or a mass is not positive.
    """

    masses: tuple[Scalar, ...] = eqx.field(converter=tuple)
    springs: tuple[Spring, ...]
    specimens: tuple[tuple[End, End], ...] = eqx.field(static=True)
    damping: ModalDamping | RayleighDamping

    def __init__(
        self,
        masses: Sequence[Scalar],
        springs: Sequence[Spring],
        specimens: Sequence[tuple[End, End]],
        damping: ModalDamping | RayleighDamping,
    ):
        self.masses = tuple(masses)
        self.springs = tuple(springs)
        self.specimens = tuple(specimens)
        self.damping = damping
        for i, mass in enumerate(self.masses):
            if isinstance(mass, int | float) and not mass > 0:
                raise ValueError(f"Every mass must be positive, but {_label(i)} is {mass} kg.")
        for what, ends in [("a spring", s.ends) for s in self.springs] + [
            ("a specimen", ends) for ends in self.specimens
        ]:
            if ends[0] == ends[1]:
                raise ValueError(f"The two ends of {what} must differ, but both are {_label(ends[0])}.")
            for end in ends:
                if end is not None and not 0 <= end < len(self.masses):
                    raise ValueError(f"An end of {what} is {_label(end)}, but there are {len(self.masses)} masses.")

    def stiffness_matrix(
        self, specimen_stiffness: Scalar | Sequence[Scalar] = 0.0
    ) -> Float[Array, "m m"] | Float[np.ndarray, "m m"]:
        """K [N/m], the specimens counted with the given stiffness [N/m], one for all or one for each."""
        # In NumPy, because the places of springs are known: only traced numbers become operations of the program.
        one = specimen_stiffness
        of_specimens = one if isinstance(one, Sequence) else [one] * len(self.specimens)
        matrix: Any = np.zeros((len(self.masses),) * 2)
        for spring in (*self.springs, *map(Spring, self.specimens, of_specimens)):
            b = self._incidence(spring.ends)
            matrix = matrix + spring.stiffness * np.outer(b, b)
        return matrix

    def damping_matrix(self) -> Float[Array, "m m"]:
        """C [N·s/m]."""
        stiffness = self.stiffness_matrix(self.damping.specimen_stiffness)
        return self.damping.matrix(jnp.asarray(self.masses), jnp.asarray(stiffness))

    def frequencies(self, specimen_stiffness: Scalar | Sequence[Scalar]) -> Float[np.ndarray, " m"]:
        """Undamped natural frequencies [Hz], lowest first, the specimens at the given stiffness [N/m], one or one for each.

        For known numbers only, so that a check of a study needs no compilation.
        """
        root = np.sqrt(np.asarray(self.masses, dtype=float))
        matrix = np.asarray(self.stiffness_matrix(specimen_stiffness), dtype=float)
        eigenvalues = np.linalg.eigvalsh(matrix / np.outer(root, root))
        return np.sqrt(np.where(_is_rigid(eigenvalues), 0.0, eigenvalues)) / (2 * np.pi)

    def told(self, values: Mapping[str, Scalar]) -> "Structure":
        """The structure with some of its numbers replaced.

        Arguments:
            values: by the names that `parameter_of` knows, SI.
        """
        if not values:
            return self
        masses = [values.get(f"mass_{i + 1}", mass) for i, mass in enumerate(self.masses)]
        springs = [
            Spring(spring.ends, values.get(f"stiffness_{i + 1}", spring.stiffness))
            for i, spring in enumerate(self.springs)
        ]
        return Structure(masses, springs, self.specimens, self.damping.told(values))

    @property
    def supports(self) -> tuple[int, ...]:
        """The springs to the ground."""
        return tuple(i for i, spring in enumerate(self.springs) if None in spring.ends)

    def altered(self, masses: ArrayLike, supports: ArrayLike) -> "Structure":
        """The structure with factors on its masses, shape () or (m,), and on the springs to the ground, () or (supports,)."""
        of_mass = jnp.broadcast_to(jnp.asarray(masses), len(self.masses))
        of_support = jnp.broadcast_to(jnp.asarray(supports), len(self.supports))
        springs = list(self.springs)
        for i, factor in zip(self.supports, of_support, strict=True):
            springs[i] = Spring(springs[i].ends, springs[i].stiffness * factor)
        changed = [mass * factor for mass, factor in zip(self.masses, of_mass, strict=True)]
        return Structure(changed, springs, self.specimens, self.damping)

    def _incidence(self, ends: tuple[End, End]) -> Float[np.ndarray, " m"]:
        b = np.zeros(len(self.masses))
        first, second = ends
        if first is not None:
            b[first] -= 1.0
        if second is not None:
            b[second] += 1.0
        return b


def _eigen(matrix: Float[Array, "m m"]) -> tuple[Float[Array, " m"], Float[Array, "m m"]]:
    """Eigenvalues and eigenvectors of a symmetric matrix."""
    return cast(tuple[Array, Array], jnp.linalg.eigh(matrix))


def _is_rigid(eigenvalues: Any) -> Any:
    """The eigenvalues of rigid-body modes, which are zero except for rounding."""
    return eigenvalues <= 1e-12 * eigenvalues[-1]


def difference(values: Sequence[Scalar], ends: tuple[End, End]) -> Scalar:
    """Value at the second end minus value at the first; the ground counts as zero."""
    first, second = ends
    if first is None:
        assert second is not None
        return values[second]
    return -values[first] if second is None else values[second] - values[first]


_KINDS = {
    "mass": (r"m_{{{}}}", "kg", "mass {}"),
    "stiffness": (r"k_{{{}}}", "N/m", "stiffness of spring {}"),
    "ratio": (r"\zeta_{{{}}}", "1", "damping ratio of mode {}"),
}
_DAMPING = {
    "ratio": Parameter("ratio", r"\zeta", "1", "damping ratio of all modes", lower=0.0, upper=1.0),
    "alpha": Parameter("alpha", r"\alpha", "1/s", "share of the masses in the damping", lower=0.0),
    "beta": Parameter("beta", r"\beta_C", "s", "share of the stiffness in the damping", lower=0.0),
}


def parameter_of(name: str) -> Parameter:
    """The declaration of a number of a structure: `mass_1`, `stiffness_1`, `ratio`, `ratio_1`, `alpha`, `beta`.

    Raises:
        KeyError: there is no number of this name.
    """
    if name in _DAMPING:
        return _DAMPING[name]
    match = re.fullmatch(r"(mass|stiffness|ratio)_([1-9]\d*)", name)
    if match is None:
        raise KeyError(name)
    symbol, unit, meaning = (text.format(match[2]) for text in _KINDS[match[1]])
    return Parameter(name, symbol, unit, meaning, lower=0.0, upper=1.0 if match[1] == "ratio" else float("inf"))


def _label(end: End) -> str:
    return "the ground" if end is None else f"mass {end + 1}"
