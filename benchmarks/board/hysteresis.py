r"""Two hysteretic laws fitted by SciPy's differential evolution: the plain law and Bouc-Wen-Baber-Noori.

The law with degradation and pinching (Baber & Noori 1985; Foliente 1995), in an elongation x and a force F that are divided by
the largest fitted ones, is

$$F = \rho x + \kappa z,\qquad \frac{dz}{dx} = \frac{h}{\eta}\Big(1 - \nu\,|z/z_y|^n\,(b\,\mathrm{sgn}(z\,dx) + 1 - b)\Big),$$

$$\nu = 1 + \delta_\nu\varepsilon,\quad \eta = 1 + \delta_\eta\varepsilon,\quad d\varepsilon = \kappa z\,dx,\quad
z_y = f_y/\kappa,\quad z_u = z_y\nu^{-1/n},$$

$$h = 1 - \zeta_1\exp\!\Big(-\frac{(z\,\mathrm{sgn}\,dx - q z_u)^2}{(\zeta_2 z_y)^2}\Big),\quad
\zeta_1 = \zeta_s(1 - e^{-p\varepsilon}),\quad \zeta_2 = (\psi + \delta_\psi\varepsilon)(\lambda + \zeta_1).$$

These are its 13 parameters: κ, f_y, ρ, b, n, δν, δη, ζs, p, q, ψ, δψ, λ. The plain law of the package has κ and f_y alone, with
b = n = 1 and the other effects absent. The code shares nothing with the package.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from board.records import Test, scales_of
from scipy.optimize import differential_evolution

# Least and largest value of each parameter, and whether its logarithm is searched.
_BOUNDS = {
    "kappa": (0.3, 300.0, True),
    "strength": (0.03, 10.0, True),
    "rho": (-0.5, 1.0, False),
    "b": (0.3, 3.0, True),
    "n": (0.5, 8.0, True),
    "delta_nu": (1e-5, 1.0, True),
    "delta_eta": (1e-5, 3.0, True),
    "zeta_s": (0.0, 0.98, False),
    "p": (1e-3, 30.0, True),
    "q": (0.0, 0.7, False),
    "psi": (0.02, 3.0, True),
    "delta_psi": (1e-5, 1.0, True),
    "lambda": (0.01, 1.0, True),
}
PLAIN = {"rho": 0.0, "b": 1.0, "n": 1.0, "delta_nu": 0.0, "delta_eta": 0.0, "zeta_s": 0.0, "p": 0.0, "q": 0.0,
         "psi": 1.0, "delta_psi": 0.0, "lambda": 1.0}  # fmt: skip
"""The parameters that the plain law holds, at what takes their effects away."""

# A row in which the elongation moves by more than this share of the largest one is divided.
_LARGEST_STEP = 1 / 50
_GENERATIONS, _PER_PARAMETER = {2: 60, 13: 300}, {2: 16, 13: 8}
# Histories are padded to few lengths, so that few programs are compiled.
_LENGTHS = [int(256 * 2 ** (k / 2)) for k in range(20)]


class Path(NamedTuple):
    """The steps of all tests, one after the other, (N,) each; `rows` (m,) are the steps at which the rows end."""

    step: np.ndarray
    elongation: np.ndarray
    is_first: np.ndarray
    force: np.ndarray
    weight: np.ndarray
    rows: np.ndarray


def path_of(tests: Sequence[Test]) -> Path:
    """Divide the ways between rows. Each test starts unloaded from zero elongation."""
    scale, strength = scales_of(tests)
    columns: list[list[np.ndarray]] = [[], [], [], [], []]
    ends, behind = [], 0
    for test in tests:
        ways = np.diff(test.elongation / scale, prepend=0.0)
        parts = np.maximum(np.ceil(np.abs(ways) / _LARGEST_STEP).astype(int), 1)
        last = np.cumsum(parts) - 1
        step = np.repeat(ways / parts, parts)
        force, weight, is_first = np.zeros(len(step)), np.zeros(len(step)), np.zeros(len(step))
        force[last], weight[last], is_first[0] = test.force / strength, test.fitted, 1.0
        for column, values in zip(columns, (step, np.cumsum(step), is_first, force, weight), strict=True):
            column.append(values)
        ends.append(behind + last)
        behind += len(step)
    length = next(size for size in _LENGTHS if size >= behind)
    padded = [np.pad(np.concatenate(c), (0, length - behind)).astype(np.float32) for c in columns]
    return Path(padded[0], padded[1], padded[2], padded[3], padded[4], np.concatenate(ends))


def fitted(tests: Sequence[Test], held: dict[str, float], seed: int = 0) -> list[np.ndarray]:
    """Fit the law, some of whose parameters are held, and simulate all tests.

    Returns:
        The force of every test, (n,) [N].
    """
    path = path_of(tests)
    free = [name for name in _BOUNDS if name not in held]
    full = partial(_full, free, held)

    def cost(x: np.ndarray) -> np.ndarray:
        return np.nan_to_num(np.asarray(_squares(full(x), *path[:5]), dtype=float), nan=1e9, posinf=1e9)

    bounds = [(np.log(low), np.log(high)) if logs else (low, high) for low, high, logs in map(_BOUNDS.get, free)]  # type: ignore[misc]
    found = differential_evolution(
        cost, bounds, vectorized=True, updating="deferred", init="sobol", polish=False, rng=seed, tol=1e-4,
        maxiter=_GENERATIONS[len(free)], popsize=_PER_PARAMETER[len(free)],
    )  # fmt: skip
    force = np.asarray(_forces(full(found.x[:, None]), *path[:3]))[path.rows, 0] * scales_of(tests)[1]
    return np.split(force, np.cumsum([len(test.force) for test in tests])[:-1])


def simulated(parameters: dict[str, float], tests: Sequence[Test]) -> list[np.ndarray]:
    """The force of every test under given parameters of the scaled law, (n,) [N]."""
    path = path_of(tests)
    columns = np.asarray([[parameters[name]] for name in _BOUNDS], dtype=np.float32)
    force = np.asarray(_forces(columns, *path[:3]))[path.rows, 0] * scales_of(tests)[1]
    return np.split(force, np.cumsum([len(test.force) for test in tests])[:-1])


def _full(free: Sequence[str], held: dict[str, float], x: np.ndarray) -> np.ndarray:
    """All parameters, (13, s), of those that are searched, (k, s)."""
    searched = {name: np.exp(row) if _BOUNDS[name][2] else row for name, row in zip(free, x, strict=True)}
    return np.stack([searched.get(name, np.full(x.shape[1], held.get(name))) for name in _BOUNDS]).astype(np.float32)


def _advance(p: jax.Array) -> Callable:
    """One step of Heun's rule for all parameter vectors, (s,)."""
    kappa, strength, _, b, n, delta_nu, delta_eta, zeta_s, p_, q, psi, delta_psi, lam = p
    yields = strength / kappa

    def advance(state, du, is_first):
        z, energy = (jnp.where(is_first > 0, 0.0, value) for value in state)
        way = jnp.sign(du)
        nu, eta = 1 + delta_nu * energy, 1 + delta_eta * energy
        ultimate = yields * nu ** (-1 / n)
        pinched = zeta_s * (1 - jnp.exp(-p_ * energy))
        width = (psi + delta_psi * energy) * (lam + pinched) * yields
        # z cannot pass its ultimate value under loading; the limit keeps a step across the yield point stable.
        limit = jnp.maximum(ultimate, jnp.abs(z))

        def slope(z):
            law = 1 - (jnp.abs(z) / ultimate) ** n * (b * jnp.sign(z * way) + 1 - b)
            return (1 - pinched * jnp.exp(-(((z * way - q * ultimate) / width) ** 2))) * law / eta

        first = slope(z)
        second = slope(jnp.clip(z + du * first, -limit, limit))
        after = jnp.clip(z + du * 0.5 * (first + second), -limit, limit)
        return after, jnp.maximum(energy + kappa * 0.5 * (z + after) * du, 0.0)

    return advance


@jax.jit
def _squares(p, step, elongation, is_first, force, weight):
    """Sum of squared residuals of each parameter vector, (s,)."""
    advance, kappa, rho = _advance(p), p[0], p[2]

    def body(state, now):
        du, x, start, measured, counts = now
        z, energy = advance(state[:2], du, start)
        return (z, energy, state[2] + counts * (rho * x + kappa * z - measured) ** 2), None

    zero = jnp.zeros(p.shape[1], jnp.float32)
    return jax.lax.scan(body, (zero, zero, zero), (step, elongation, is_first, force, weight), unroll=2)[0][2]


@jax.jit
def _forces(p, step, elongation, is_first):
    """Force after every step, (N, s)."""
    advance = _advance(p)

    def body(state, now):
        state = advance(state, *now)
        return state, state[0]

    zero = jnp.zeros(p.shape[1], jnp.float32)
    z = jax.lax.scan(body, (zero, zero), (step, is_first))[1]
    return p[2] * elongation[:, None] + p[0] * z
