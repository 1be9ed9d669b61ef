r"""What drives an experiment, and its samples on the half-step grid of the integration.

An excitation is a function of time.  The integrator asks for it at the ends and the middle of every step, so each
excitation is turned into a *forcing*: a carry and an `advance` that moves it by half a step.  The near-fault pulse
advances by two complex rotations, which is exact and twenty times cheaper than sines and cosines; anything else is a
table.
"""

from abc import abstractmethod
from typing import NamedTuple, final

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, PyTree

Scalar = Float[Array, ""] | float


class Imposed(NamedTuple):
    """Elongation [m] and its rate [m/s] imposed on the specimen at one instant."""

    elongation: Scalar
    rate: Scalar


class AbstractForcing(eqx.Module):
    """An excitation on the half-step grid t_k = k·h/2, k = 0 … 2n."""

    @abstractmethod
    def start(self) -> tuple[PyTree, PyTree]:
        """The carry and the sample at t = 0."""

    @abstractmethod
    def advance(self, carry: PyTree, index: ArrayLike) -> tuple[PyTree, PyTree]:
        """The carry and the sample at grid point `index`, from the carry at `index - 1`."""


@final
class Tabulated(AbstractForcing):
    """Samples in a table; `samples` is a pytree of arrays of shape (2n+1,)."""

    samples: PyTree

    def start(self) -> tuple[PyTree, PyTree]:
        """No carry: the table is read by its index."""
        return None, self._at(0)

    def advance(self, carry: PyTree, index: ArrayLike) -> tuple[PyTree, PyTree]:
        """The sample in row `index`."""
        return None, self._at(index)

    def _at(self, index: ArrayLike) -> PyTree:
        return jax.tree.map(lambda samples: samples[index], self.samples)


@final
class Scaled(AbstractForcing):
    """A forcing times a factor."""

    forcing: AbstractForcing
    factor: Scalar

    def start(self) -> tuple[PyTree, PyTree]:
        """The carry of the forcing and its first sample, scaled."""
        return self._times(*self.forcing.start())

    def advance(self, carry: PyTree, index: ArrayLike) -> tuple[PyTree, PyTree]:
        """The carry of the forcing and its sample, scaled."""
        return self._times(*self.forcing.advance(carry, index))

    def _times(self, carry: PyTree, sample: PyTree) -> tuple[PyTree, PyTree]:
        return carry, jax.tree.map(lambda values: values * self.factor, sample)


class AbstractExcitation(eqx.Module):
    """A ground motion, as acceleration of the ground over time."""

    @abstractmethod
    def acceleration(self, time: Scalar) -> Scalar:
        """Ground acceleration [m/s²] at one instant [s]."""

    @abstractmethod
    def forcing(self, step: Scalar, steps: int) -> AbstractForcing:
        """The excitation on the half-step grid of `steps` steps of length `step` [s]."""


@final
class NearFaultPulse(AbstractExcitation):
    r"""Near-fault velocity pulse of Dabaghi and Der Kiureghian, started at t = 0.

    $$v(t) = \Big\{\tfrac12 V_P\cos\Big[2\pi\tfrac{t-t_{max}}{T_P}+\nu\Big]-\tfrac{D_r}{\gamma T_P}\Big\}
             \Big\{1+\cos\Big[\tfrac{2\pi}{\gamma}\tfrac{t-t_{max}}{T_P}\Big]\Big\},\qquad
      D_r = V_P T_P\,\frac{\sin(\nu+\gamma\pi)-\sin(\nu-\gamma\pi)}{4\pi(1-\gamma^2)}$$

    on |t − t_max| ≤ γT_P/2 and zero outside, with t_max = γT_P/2; the ground acceleration is its exact derivative, which
    is zero at both ends, so the excitation is continuous.

    Source: Dabaghi & Der Kiureghian 2017; Abbiati & Marelli, Eqs. 16–17.

    Arguments:
        V_P: peak velocity [m/s].
        T_P: period [s].
        gamma: number of oscillations within the pulse [–], not 1.
        nu: phase [rad].
    """

    V_P: Scalar
    T_P: Scalar
    gamma: Scalar = 2.0
    nu: Scalar = 0.10

    @property
    def duration(self) -> Scalar:
        """Length of the pulse, γT_P [s]."""
        return self.gamma * self.T_P

    def velocity(self, time: Scalar) -> Scalar:
        """Ground velocity [m/s] at one instant [s] (Eq. 16)."""
        carrier, envelope = self._phases(time)
        v = (0.5 * self.V_P * jnp.cos(carrier) - self._offset()) * (1 + jnp.cos(envelope))
        return jnp.where(self._is_inside(time), v, 0.0)

    def acceleration(self, time: Scalar) -> Scalar:
        """Ground acceleration [m/s²] at one instant [s], the derivative of Eq. 16."""
        carrier, envelope = self._phases(time)
        a = self._combine((jnp.cos(carrier), jnp.sin(carrier)), (jnp.cos(envelope), jnp.sin(envelope)))
        return jnp.where(self._is_inside(time), a, 0.0)

    def forcing(self, step: Scalar, steps: int) -> AbstractForcing:
        """The pulse as two rotating phasors."""
        carrier, envelope = self._phases(0.0)
        carrier_rate, envelope_rate = self._angular_frequencies()
        duration = jax.lax.stop_gradient(self.duration)
        return _RotatingPulse(
            pulse=self,
            half_step=0.5 * step,
            last=eqxi.unvmap_max(jnp.asarray(duration / (0.5 * step))),
            phasors=(_unit(carrier), _unit(envelope)),
            rotations=(_unit(0.5 * step * carrier_rate), _unit(0.5 * step * envelope_rate)),
        )

    def _angular_frequencies(self) -> tuple[Scalar, Scalar]:
        carrier = 2 * jnp.pi / self.T_P
        return carrier, carrier / self.gamma

    def _phases(self, time: Scalar) -> tuple[Scalar, Scalar]:
        carrier, envelope = self._angular_frequencies()
        since_peak = time - 0.5 * self.duration
        return carrier * since_peak + self.nu, envelope * since_peak

    def _offset(self) -> Scalar:
        """D_r / (γ T_P): takes away the permanent displacement (Eq. 17)."""
        turn = self.gamma * jnp.pi
        sines = jnp.sin(self.nu + turn) - jnp.sin(self.nu - turn)
        return self.V_P * sines / (4 * jnp.pi * (1 - self.gamma**2) * self.gamma)

    def _combine(self, carrier: tuple, envelope: tuple) -> Scalar:
        carrier_rate, envelope_rate = self._angular_frequencies()
        half = 0.5 * self.V_P
        return (
            -half * carrier_rate * carrier[1] * (1 + envelope[0])
            - (half * carrier[0] - self._offset()) * envelope_rate * envelope[1]
        )

    def _is_inside(self, time: Scalar) -> Bool[ArrayLike, ""]:
        return (time >= 0) & (time <= self.duration)


class _RotatingPulse(AbstractForcing):
    pulse: NearFaultPulse
    half_step: Scalar
    last: Scalar  # half steps until the longest pulse of the batch is over
    phasors: tuple
    rotations: tuple

    def start(self) -> tuple[PyTree, PyTree]:
        return self.phasors, self.pulse.acceleration(0.0)

    def advance(self, carry: PyTree, index: ArrayLike) -> tuple[PyTree, PyTree]:
        def shaken():
            carrier, envelope = (_rotate(*pair) for pair in zip(carry, self.rotations, strict=True))
            inside = jnp.asarray(index) * self.half_step <= self.pulse.duration
            return (carrier, envelope), jnp.where(inside, self.pulse._combine(carrier, envelope), 0.0)

        # The same for all lanes of a batch, so it stays a branch: most of an experiment is free vibration.
        return jax.lax.cond(jnp.asarray(index) <= self.last, shaken, lambda: (carry, jnp.zeros(())))


def _unit(angle: Scalar) -> tuple[Scalar, Scalar]:
    return jnp.cos(angle), jnp.sin(angle)


def _rotate(phasor: tuple, rotation: tuple) -> tuple[Scalar, Scalar]:
    (c, s), (cr, sr) = phasor, rotation
    return c * cr - s * sr, s * cr + c * sr


@final
class RecordedMotion(AbstractExcitation):
    """A recorded accelerogram, linear between its samples and zero outside them.

    Arguments:
        time: sample times [s], increasing, shape (m,).
        ground_acceleration: samples [m/s²], shape (m,).
    """

    time: Float[Array, " m"] = eqx.field(converter=jnp.asarray)
    ground_acceleration: Float[Array, " m"] = eqx.field(converter=jnp.asarray)

    def acceleration(self, time: Scalar) -> Scalar:
        """Ground acceleration [m/s²] at one instant [s]."""
        return jnp.interp(time, self.time, self.ground_acceleration, left=0.0, right=0.0)

    def forcing(self, step: Scalar, steps: int) -> AbstractForcing:
        """The record, interpolated on the half-step grid once, before the integration."""
        return Tabulated(jax.vmap(self.acceleration)(0.5 * step * jnp.arange(2 * steps + 1)))
