r"""Parameters that vary between specimens: every member of a level has its own, and all come from one population.

$$\theta_m = \bar\theta\,e^{d_m} \;\text{(positive ones)}\quad\text{or}\quad \theta_m = \bar\theta + d_m, \qquad
  d_m = \sum_{\text{levels}} \tau\,z_m,\qquad z_m\sim N(0,1)$$

The centre $\bar\theta$ has the prior that the study gives the parameter; the spread τ of every level has its own prior.
Levels may be nested (bars of a mill): their offsets add up.  A population is therefore an ordinary posterior. Its further
parameters are spreads and standardised offsets, and each experiment is simulated with the parameters of its own members.

The coordinates z are unsuitable for a sampler if the measurements determine $d_m$ better than the population does: then every
change of τ changes all z.  Therefore the sampler moves $c_m = z_m\sqrt{(s_m^2 + \tau^2)/(s_m^2 + \tau_0^2)}$, where $s_m$ is
the standard deviation of $d_m$ from the measurements alone. $c_m$ is the offset itself if τ is larger, and z if it is smaller.
Given the centre, it has the same variance for every τ (after Papaspiliopoulos, Roberts & Sköld 2007).  So the mode of its
density is where that of τ alone has its mode, by Laplace's method and given the centre.

Source: Gelman & Hill 2007.
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hsed_jax.inference.likelihood import LOG_2PI
from hsed_jax.inference.priors import Prior

# Information on a standardised offset that is as good as none.
_HARDLY = 1e-9
# A search begins at this share of the median of a spread's prior, or above.
_LEAST = 0.2


@cache
def spread_scaling(prior: Prior) -> tuple[float, ...]:
    """The scaling of u for a spread (`hsed_jax.inference.distributions.map_to`).

    For small spreads u is the logarithm, which the offsets follow.  For large spreads it is the spread itself, because the
    density of its logarithm would end abruptly.
    """
    if prior.bounds != (0.0, None):
        return prior.scaling
    from hsed_jax.inference.distributions import of_order_one  # loads numpyro, which a check of a study has no use for

    return of_order_one(prior.quantile, prior.distribution, (float(prior.quantile(0.5)),))


class Varying(NamedTuple):
    """A parameter that varies with a level.

    Attributes:
        name, column: its name, and where it stands among the parameters of the model.
        is_log: whether its logarithm varies, and not itself.
        spread: prior of τ, of the logarithm or SI.
        lower, upper: bounds of all members, SI.
    """

    name: str
    column: int
    is_log: bool
    spread: Prior
    lower: float = -np.inf
    upper: float = np.inf


class Level(NamedTuple):
    """A column of the experiments.

    Attributes:
        name: of the column.
        members: its values, M of them.
        varying: the parameters that vary with it, K of them.
    """

    name: str
    members: tuple[str, ...]
    varying: tuple[Varying, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """(K, M)."""
        return len(self.varying), len(self.members)


@final
class Population(eqx.Module):
    """The parameters that vary between the specimens of a study; none without levels.

    Arguments:
        levels: the outer ones first.
        first: number of parameters before those of the population.

    Attributes:
        told: s of each offset, of the scale of its spread; infinite without information, (K, M) a level.
        reference: τ₀ of every spread, one array (K,) a level.
    """

    levels: tuple[Level, ...] = eqx.field(static=True)
    first: int = eqx.field(static=True)
    told: tuple[Float[Array, "_ _"], ...]
    reference: tuple[Float[Array, " _"], ...]

    def __init__(self, levels: Sequence[Level] = (), first: int = 0):
        self.levels, self.first = tuple(levels), first
        self.told = tuple(jnp.full(level.shape, jnp.inf) for level in self.levels)
        self.reference = tuple(jnp.ones(level.shape[0]) for level in self.levels)

    @property
    def spreads(self) -> dict[str, Prior]:
        """Priors of the spreads of all levels, by name."""
        return {f"{level.name}.{varying.name}.spread": varying.spread for level, varying in self._varying}

    @property
    def offsets(self) -> tuple[str, ...]:
        """Names of the standardised offsets, which stand after all spreads."""
        return tuple(f"{level.name}.{v.name}.{member}" for level, v in self._varying for member in level.members)

    @property
    def _varying(self) -> list[tuple[Level, Varying]]:
        return [(level, varying) for level in self.levels for varying in level.varying]

    def log_prior(self, theta: Float[Array, " p"]) -> Float[Array, ""]:
        """Log density of the offsets given the population."""
        z = theta[self.first + len(self._varying) :] if self.levels else jnp.zeros(0)
        return -0.5 * jnp.sum(z**2) - 0.5 * LOG_2PI * z.size

    @property
    def places(self) -> list[tuple[slice, slice]]:
        """The places of the spreads and offsets of each level in θ."""
        place, spreads, offsets = self.first, [], []
        for level in self.levels:
            spreads.append(slice(place, place := place + level.shape[0]))
        for level in self.levels:
            offsets.append(slice(place, place := place + math.prod(level.shape)))
        return list(zip(spreads, offsets, strict=True))

    def of(self, theta: Float[Array, " p"], level: int) -> tuple[Float[Array, " K"], Float[Array, "K M"]]:
        """Spreads and standardised offsets of a level."""
        spreads, offsets = self.places[level]
        return theta[spreads], theta[offsets].reshape(self.levels[level].shape)

    def own(
        self,
        theta: Float[Array, " p"],
        center: Float[Array, " q"],
        members: Int[Array, "n L"],
        strangers: tuple[Float[Array, "_ _"], ...] = (),
    ) -> Float[Array, "n q"]:
        """The parameters of the model of each experiment.

        Arguments:
            theta: all parameters.
            center: those of the model, at the centre of the population.
            members: of each experiment its member of every level.
            strangers: standardised offsets (K, ·) of members beyond those of each level.
        """
        own = jnp.broadcast_to(center, (members.shape[0], center.size))
        for number, level in enumerate(self.levels):
            spreads, offsets = self.of(theta, number)
            offsets = jnp.concatenate([offsets, *strangers[number : number + 1]], axis=1)
            own = _moved(own, level, (spreads[:, None] * offsets)[:, members[:, number]].T)
        return self._within(own)

    def strangers(self, members: Int[Array, "n L"], draws: int) -> tuple[Float[Array, "S _ _"], ...]:
        """Standardised offsets of members that the levels do not know, (S, K, ·) a level: drawn, and zero in the first draw."""
        random, found = np.random.default_rng(0), []
        for level, own in zip(self.levels, np.asarray(members).T, strict=True):
            (many, known), last = level.shape, int(own.max(initial=-1))
            drawn = random.standard_normal((draws, many, max(last + 1 - known, 0)))
            drawn[:1] = 0.0
            found.append(jnp.asarray(drawn))
        return tuple(found)

    def of_members(
        self, theta: Float[Array, " p"], center: Float[Array, " q"], members: np.ndarray
    ) -> tuple[Array, ...]:
        """The parameters of the model of each member, (M, q) a level.

        Arguments:
            theta: all parameters.
            center: those of the model, at the centre of the population.
            members: of each experiment its member of every level, (n, L); they determine the outer member of each member.
        """
        rows = jnp.asarray(np.concatenate(self._of_each(members)))
        none = tuple(jnp.zeros((level.shape[0], 1)) for level in self.levels)
        found = self.own(theta, center, rows, none)
        ends = np.cumsum([len(level.members) for level in self.levels])[:-1]
        return tuple(jnp.split(found, ends))

    def _of_each(self, members: np.ndarray) -> list[np.ndarray]:
        """For each member of a level, its members of all levels: itself and the outer members that contain it;
        otherwise none.
        """
        none = np.asarray([len(level.members) for level in self.levels])
        tables = []
        for number, level in enumerate(self.levels):
            table = np.tile(none, (len(level.members), 1))
            for member, row in enumerate(table):
                own = members[members[:, number] == member, :number]
                if len(own):
                    row[:number] = np.where((own == own[0]).all(axis=0), own[0], none[:number])
                row[number] = member
            tables.append(table)
        return tables

    def _within(self, own: Float[Array, "n q"]) -> Float[Array, "n q"]:
        low, high = np.full(own.shape[1], -np.inf), np.full(own.shape[1], np.inf)
        for _, varying in self._varying:
            low[varying.column], high[varying.column] = varying.lower, varying.upper
        return jnp.clip(own, low, high)

    # Coordinates of a sampler.

    def released(self, theta: Float[Array, " p"]) -> Float[Array, " p"]:
        """θ with z instead of the offsets c."""
        return self._scaled(theta, -1)

    def held(self, theta: Float[Array, " p"]) -> Float[Array, " p"]:
        """The inverse: c instead of z."""
        return self._scaled(theta, 1)

    def _scaled(self, theta: Float[Array, " p"], sign: int) -> Float[Array, " p"]:
        for number, (_, place) in enumerate(self.places):
            _, offsets = self.of(theta, number)
            theta = theta.at[place].set((offsets * jnp.exp(sign * self._log_factor(theta, number))).ravel())
        return theta

    def _log_factor(self, theta: Float[Array, " p"], number: int) -> Float[Array, "K M"]:
        spreads, _ = self.of(theta, number)
        now, reference = (jnp.log1p((x[:, None] / self.told[number]) ** 2) for x in (spreads, self.reference[number]))
        return 0.5 * (now - reference)

    def log_jacobian(self, theta: Float[Array, " p"]) -> Float[Array, ""]:
        """Log of how much `released` changes volumes."""
        terms = [-jnp.sum(self._log_factor(theta, number)) for number in range(len(self.levels))]
        return sum(terms, start=jnp.zeros(()))

    def settled(self, theta: Float[Array, " p"]) -> Float[Array, " p"]:
        """The same members with spreads that match the scatter of their offsets, and are not far below their priors.

        The joint density is highest at spreads that no measurement supports.
        """
        for number, (level, (spreads, offsets)) in enumerate(zip(self.levels, self.places, strict=True)):
            old, z = self.of(theta, number)
            least = jnp.stack([_LEAST * v.spread.quantile(0.5) for v in level.varying])
            new = jnp.maximum(old * jnp.sqrt(jnp.mean(z**2, axis=1)), least)
            theta = theta.at[spreads].set(new).at[offsets].set((z * (old / new)[:, None]).ravel())
        return theta

    def centred(self, theta: np.ndarray, information: np.ndarray) -> "Population":
        """The same in coordinates that follow the measurements of its offsets.

        Arguments:
            theta: where, (p,).
            information: that the measurements have there, in coordinates of which standardised offsets are some, (p, p).
        """
        told, reference = [], []
        for number, (level, (_, place)) in enumerate(zip(self.levels, self.places, strict=True)):
            spreads, _ = self.of(jnp.asarray(theta), number)
            variances = np.zeros(level.shape)
            positions = np.arange(place.start, place.stop).reshape(level.shape)
            for member, own in enumerate(positions.T):
                # The data do not determine a parameter that others of its member can replace.
                block = information[np.ix_(own, own)] + _HARDLY * np.eye(len(own))
                variances[:, member] = np.diag(np.linalg.inv(block))
            told.append(spreads[:, None] * jnp.sqrt(jnp.asarray(variances)))
            reference.append(spreads)
        return eqx.tree_at(lambda p: (p.told, p.reference), self, (tuple(told), tuple(reference)))


def _moved(own: Any, level: Level, moves: Any) -> Any:
    """Parameters (..., q) moved by (..., K)."""
    for k, varying in enumerate(level.varying):
        old = own[..., varying.column]
        new = old * jnp.exp(moves[..., k]) if varying.is_log else old + moves[..., k]
        own = own.at[..., varying.column].set(new)
    return own
