"""Steps that become shorter: the observed order of each law and of a frame, and the error that two steps predict."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.shares import by_default
from observations import of_largest

from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.laws import LAWS
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Recorded, Simulator, Timeline
from hsed_jax.physics.structures import RayleighDamping, Structure

pytestmark = pytest.mark.optimised
K, MASS = 5e5, 8e3
PARAMETERS = {
    "elastic": {"k": K},
    "bilinear": {"k": K, "F_y": 6e4, "b": 0.05},
    "menegotto_pinto": {"k": K, "F_y": 6e4, "b": 0.05, "R0": 15.0, "a1": 0.1, "a3": 0.05, "a2": 1.5, "a4": 2.0},
    "takeda": {"k": K, "F_y": 6e4, "b": 0.05, "alpha": 0.4},
    "bouc_wen": {"A": K, "beta": 0.03, "gamma": 0.004, "n": 1.5},
}
# Largest error on the short step, and the least order: a corner within a step costs the orders of RK4 beyond the second.
PROMISED = {
    "elastic": (6e-6, 3.9),
    "bilinear": (6e-4, 1.7),
    "menegotto_pinto": (1.2e-5, 2.7),
    "takeda": (4e-4, 1.5),
    "bouc_wen": (1.5e-4, 2.3),
}
DURATION, COUNTS, FINEST = 4.0, (100, 200, 400, 800), 6400
# Where errors are looked at: ends of steps of every count.
INSTANTS = 100
# The step that is judged, and the one of twice its length: 79 and 40 steps to the period of the oscillator.
SHORT, LONG = 400, 200
# Of an index from two steps: how many times the error that the order promises.
SAFETY = 3.0
# Motions, each three waves under a window.
MOTIONS = 12


def lengths(count: int) -> np.ndarray:
    """So many steps, and what is left over is padding."""
    return np.where(np.arange(FINEST) < count, DURATION / count, 0.0)


def half_steps(count: int) -> np.ndarray:
    """Ends and middles of the steps."""
    ends = np.concatenate([[0.0], np.cumsum(lengths(count))])
    times = np.empty(2 * FINEST + 1)
    times[::2], times[1::2] = ends, (ends[1:] + ends[:-1]) / 2
    return times


def waves(time) -> np.ndarray:
    """Smooth accelerations of the ground, (MOTIONS, times): the end of a pulse within a step would cost an order."""
    random = np.random.default_rng(0)
    sizes, frequencies, phases = (random.uniform(*ends, (3, MOTIONS, 1)) for ends in ((3, 9), (0.5, 2.0), (0, 6.3)))
    window = np.sin(np.pi * time / DURATION) ** 2
    return window * np.sum(sizes * np.sin(2 * np.pi * frequencies * time + phases), axis=0)


def shaken(simulator, parameters):
    """From a number of steps to the elongation at the instants under each motion, (MOTIONS, INSTANTS + 1)."""

    @jax.jit
    def program(samples, step_length):
        def one(ground):
            conditions = Conditions({}, Recorded(Tabulated(ground), step_length))
            response = simulator.respond(parameters, conditions, ("elongation",))
            return response.channels["elongation"], response.ok

        return jax.vmap(one)(samples)

    def respond(count):
        found, ok = program(waves(half_steps(count)), lengths(count))
        assert ok.all()
        return np.asarray(found)[:, : count + 1 : count // INSTANTS]

    return respond


def refined(respond):
    """Errors (counts, motions), order with its standard error, grid convergence indices of the short step, (motions,)."""
    truth, found = respond(FINEST), {count: respond(count) for count in COUNTS}
    errors = np.array([[of_largest(*pair) for pair in zip(found[count], truth, strict=True)] for count in COUNTS])
    orders = -np.polyfit(np.log(COUNTS), np.log(errors), 1)[0]
    order, error = orders.mean(), orders.std(ddof=1) / np.sqrt(orders.size)
    apart = np.array([of_largest(*pair) for pair in zip(found[LONG], found[SHORT], strict=True)])
    return errors, (order, error), SAFETY * apart / (2**order - 1)


def judge(observed, problem, respond, promised):
    """The rows of a problem: its error at the short step, and whether the order is what is promised."""
    (largest, least), (errors, (order, scatter), indices) = promised, refined(respond)
    at_short = errors[COUNTS.index(SHORT)]
    covered = np.mean(indices >= at_short)
    observed(problem, f"{FINEST} steps", at_short, largest, order=order, standard_error=scatter,
             grid_convergence_index=indices.max(), index_covers=covered)  # fmt: skip
    assert order - 2 * scatter > least
    assert covered >= 0.9


@pytest.mark.verification("convergence")
@pytest.mark.parametrize("law", by_default(LAWS, lambda law: law == "bilinear"))
def test_an_oscillator_on_a_law_converges(law, observed):
    structure = Structure((MASS,), (), ((None, 0),), RayleighDamping(2 * 0.03 * np.sqrt(K / MASS), 0.0))
    simulator = Simulator(structure, None, Timeline(None, FINEST), elements=(Element(law=LAWS[law]),))
    judge(
        observed,
        f"{law}: oscillator under 12 motions, {SHORT} steps",
        shaken(simulator, PARAMETERS[law]),
        PROMISED[law],
    )


@pytest.mark.whole
@pytest.mark.verification("convergence")
def test_the_frame_of_the_paper_converges(paper_simulator, observed):
    simulator = paper_simulator(excitation=None, effects=("stiffness_degradation",), timeline=Timeline(None, FINEST))
    respond = shaken(simulator, {"A": 5e5, "beta": 1.0, "stiffness_degradation.delta": 2e-5})
    judge(observed, f"paper's frame with degradation under 12 motions, {SHORT} steps", respond, (3e-5, 3.5))


@pytest.mark.verification("convergence")
def test_a_specimen_that_is_pulled_converges(observed):
    simulator = Simulator(
        None, None, Timeline(None, FINEST), EFFECTS.only(["strength_degradation"]), Scales(6e4, 0.25, 1.5, 2e4),
        elements=(Element(law=LAWS["bouc_wen"]),),
    )  # fmt: skip
    parameters = {**PARAMETERS["bouc_wen"], "strength_degradation.delta": 0.3}

    @jax.jit
    def program(paths, step_length):
        def one(path):
            response = simulator.respond(parameters, Conditions({}, Recorded(Tabulated(path), step_length)), ("force",))
            return response.channels["force"], response.ok

        return jax.vmap(one)(paths)

    def respond(count):
        # Three cycles of each amplitude; the turns lie within the steps.
        time, omega = half_steps(count), 2 * np.pi * 3 / DURATION * 1.013
        sizes = np.linspace(0.2, 0.4, MOTIONS)[:, None]
        path = Imposed(jnp.asarray(sizes * np.sin(omega * time)), jnp.asarray(sizes * omega * np.cos(omega * time)))
        found, ok = program(path, lengths(count))
        assert ok.all()
        return np.asarray(found)[:, : count + 1 : count // INSTANTS]

    judge(observed, f"bouc_wen with degradation, pulled along 12 sines, {SHORT} steps", respond, (1e-4, 2.5))
