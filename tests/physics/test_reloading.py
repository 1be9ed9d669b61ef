"""How a specimen comes back, against closed forms along the path and a flag of OpenSees: self-centring, reloading towards a peak,
buckling, scragging."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.integrate import integrate
from hsed_jax.physics.laws import BoucWen
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.specimen import Specimen
from hsed_jax.physics.systems import DrivenSpring

A, STRENGTH = 1e7, 8e4
YIELD = STRENGTH / A
SCALES = Scales(force=STRENGTH, elongation=0.04, rate=0.1, energy=3e3)
STEPS = 2000


def along(turns, law=None, **effects):
    """Elongations of a path between turning points, in equal parts each, and the force there."""
    legs = [np.linspace(a, b, STEPS + 1) for a, b in itertools.pairwise(turns)]
    u = np.concatenate([legs[0][:1], *(leg[1:] for leg in legs)])
    middle = 0.5 * (u[1:] + u[:-1])
    half = np.empty(2 * len(u) - 1)
    half[::2], half[1::2] = u, middle
    rate = np.repeat(np.diff(u), 2)
    rate = np.concatenate([rate[:1], rate])
    law = law or BoucWen(A=A, beta=0.5 * A / STRENGTH, gamma=0.5 * A / STRENGTH, n=1.0)
    specimen = Specimen(law, tuple(EFFECTS[name](**values) for name, values in effects.items()), SCALES)
    forcing = Tabulated(Imposed(jnp.asarray(half), jnp.asarray(rate)))
    response = integrate(DrivenSpring((specimen,)), forcing, 1.0, len(u) - 1, channels=("force",))
    assert bool(response.ok)
    return u, np.asarray(response.channels["force"])


@pytest.mark.parametrize("back", [0.2, 0.6])
def test_a_flag_slides_back_at_its_force_and_closes(back):
    u, force = along([0.0, 0.04, 0.0, -0.04, 0.0], self_centering={"delta": back})
    down = slice(STEPS, 2 * STEPS + 1)
    # Halfway back it slides, a little below where it begins to, since the transition is smooth.
    plateau = np.interp(0.02, u[down][::-1], force[down][::-1])
    assert (back - 0.15) * STRENGTH < plateau < (back + 0.02) * STRENGTH
    # Without force it is back where it began, within what closes smoothly.
    closed = np.interp(0.0, force[down][::-1], u[down][::-1])
    assert abs(closed) < 0.03 * 0.04
    # The same to the other side, but for what closes smoothly.
    np.testing.assert_allclose(force[2 * STEPS :], -force[: 2 * STEPS + 1], atol=0.04 * STRENGTH)
    plain = along([0.0, 0.04, 0.0])[1]
    assert plain[-1] < -0.5 * STRENGTH < -0.04 * STRENGTH < force[2 * STEPS]


def test_a_flag_is_that_of_opensees():
    ops = pytest.importorskip("openseespy.opensees", reason="openseespy cannot be imported", exc_type=ImportError)
    back, turns = 0.4, [0.0, 0.02, 0.0, -0.02, 0.0, 0.04, 0.0, -0.04, 0.0]
    # Sharp yielding, elastic unloading.
    law = BoucWen(A=A, beta=0.5 * A / STRENGTH**12, gamma=0.5 * A / STRENGTH**12, n=12.0)
    u, force = along(turns, law, self_centering={"delta": back})
    ops.wipe()
    ops.uniaxialMaterial("SelfCentering", 1, A, 1e-6 * A, STRENGTH, 1 - back)
    ops.testUniaxialMaterial(1)
    expected = []
    for elongation in u:
        ops.setStrain(float(elongation))
        expected.append(ops.getStress())
    assert np.sqrt(np.mean((force - np.asarray(expected)) ** 2)) < 0.08 * STRENGTH


@pytest.mark.parametrize("sharp", [0.0, 1.0])
def test_a_tendon_beside_the_element_returns_the_way_it_came(sharp):
    n, turns = 1.0 + 19.0 * sharp, [0.0, 0.04, 0.0, -0.04, 0.0]
    law = BoucWen(A=A, beta=0.5 * A / STRENGTH**n, gamma=0.5 * A / STRENGTH**n, n=n)
    u, plain = along(turns, law)
    force = along(turns, law, self_centering={"delta": 0.6, "tendon": 1.0, "sharp": sharp})[1]
    # On its first way, the element follows the virgin curve that the tendon never leaves.
    tendon = np.interp(np.abs(u), u[: STEPS + 1], plain[: STEPS + 1]) * np.sign(u)
    np.testing.assert_allclose(force, 0.4 * plain + 0.6 * tendon, atol=(1e-4 + 0.03 * sharp) * STRENGTH)
    back = slice(STEPS, 2 * STEPS + 1)
    assert np.interp(0.0, plain[back][::-1], u[back][::-1]) > 0.03
    assert abs(np.interp(0.0, force[back][::-1], u[back][::-1])) < 0.01


@pytest.mark.parametrize(("sharp", "largest"), [(0.0, 0.04), (1.0, 0.04), (0.0, 0.7 * YIELD)])
def test_reloading_goes_straight_to_the_former_peak(sharp, largest):
    n = 1.0 + 19.0 * sharp
    law = BoucWen(A=A, beta=0.5 * A / STRENGTH**n, gamma=0.5 * A / STRENGTH**n, n=n)
    u, force = along([0.0, largest, -largest, 1.25 * largest], law, peak_oriented={"delta": 1.0, "sharp": sharp})
    leg, peak = slice(2 * STEPS, None), STRENGTH * min(1 - np.exp(-largest / YIELD) + sharp, 1.0)
    reloads = (force[leg] > 0) & (u[leg] < 0.8 * largest)
    begin = u[leg][reloads][0]
    # dz/du = (z_p − z)/(u_p − u) has this line as its solution.
    line = peak * (u[leg][reloads] - begin) / (largest - begin)
    np.testing.assert_allclose(force[leg][reloads], line, atol=(0.01 + 0.02 * sharp) * STRENGTH)
    without = along([0.0, largest, -largest, 1.25 * largest], law)[1]
    assert np.abs(without[leg][reloads] - line).max() > 0.03 * STRENGTH
    # What was never reached is as without it.
    plain = along([0.0, largest], law)[1]
    np.testing.assert_allclose(force[: STEPS + 1], plain, rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_brace_buckles_to_one_side_and_is_late_on_the_other(side):
    values = {"delta": 0.4 * side, "growth": 2.0, "late": 1.0}
    turns = side * np.array([0.0, 0.04, -0.04, 0.04])
    u, force = along(turns, buckling=values)
    u, force = side * u, side * force
    assert force[STEPS] == pytest.approx(STRENGTH * (1 - np.exp(-0.04 / YIELD)), rel=1e-4)
    # At the end of the leg: z_u (1 − δ)/(1 + κ δ), its largest excursion the characteristic one.
    assert force[2 * STEPS] == pytest.approx(-STRENGTH * 0.6 / 1.8, rel=0.05)
    plain = along([0.0, 0.04, -0.04, 0.04])[1]
    there = slice(2 * STEPS, 3 * STEPS + 1)
    early = np.interp(0.0, u[there], force[there]), np.interp(0.0, u[there], plain[there])
    assert early[0] < 0.8 * early[1]


def test_a_specimen_that_was_scragged_is_softer_within_what_it_has_been_through():
    nothing = BoucWen(A=1.0, beta=1.0, gamma=0.0, n=1.0)
    u, force = along([0.0, 0.02, 0.0, 0.04], nothing, scragging={"delta": 0.5, "power": 2.0})
    spring = 0.5 * STRENGTH / 0.04
    first, again = slice(0, STEPS + 1), slice(STEPS, 2 * STEPS)
    np.testing.assert_allclose(force[first], spring * u[first], atol=1e-3 * STRENGTH)
    np.testing.assert_allclose(force[again], spring * u[again] * (u[again] / 0.02) ** 2, atol=1e-3 * STRENGTH)
    np.testing.assert_allclose(force[-1], spring * 0.04, rtol=1e-3)


def test_a_back_stress_saturates_along_the_plastic_elongation():
    # Of an element that hardly has a force all elongation is plastic.
    nothing = BoucWen(A=1e3, beta=2e4, gamma=0.0, n=1.0)
    u, force = along([0.0, 0.04, -0.04], nothing, kinematic_hardening={"delta": 0.5, "bristle": 0.25})
    bound, length = 0.5 * 0.25 * STRENGTH, 0.25 * 0.04
    forth = bound * -np.expm1(-u[: STEPS + 1] / length)
    np.testing.assert_allclose(force[: STEPS + 1], forth, atol=0.01 * bound)
    way = 0.04 - u[STEPS:]
    np.testing.assert_allclose(force[STEPS:], -bound + (forth[-1] + bound) * np.exp(-way / length), atol=0.02 * bound)
