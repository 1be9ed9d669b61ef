"""How far the generator can be trusted: `python -m hidden.check` in the folder `benchmarks` prints the largest differences.

Against the paper's reference quantities, and of every effect of the specimen or the frame against SciPy's DOP853.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from .campaigns import FINE, TooSmall, amplitude, respond
from .cases import Case, Measured, Plan, draw
from .catalogue import FORMULAS
from .sensors import Program
from .specimen import DURATION, Frame, Scales, Specimen, driven_rates, modal_damping, pulse, shake, shaken_rates

UNITS = np.array([0.1, 0.1, 1.0, 1.0, 1e5, 1e4, 1e4, 1.0])  # of the states, for the tolerance
REFERENCE = Path(__file__).resolve().parents[2] / "tests" / "data" / "reference_quantities.csv"


def against_reference(path: Path = REFERENCE) -> dict[str, float]:
    """Largest relative difference per simulator and quantity; there C is formed with the model's own A."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    worst = {}
    for name in ("HS", "CS"):
        column = {
            k: np.array([float(r[k]) for r in rows if r["simulator"] == name]) for k in rows[0] if k != "simulator"
        }
        c = np.array([modal_damping(a) for a in column["A"]])
        specimen = Specimen(column["A"], column["beta"])
        specimen.acts = [(lambda x, s, p: setattr(s, "eta", 1 + p["eta"] * x.energy), {"eta": column["eta"]}, 0)]
        run = shake(specimen, Frame(c11=c[:, 0, 0], c12=c[:, 0, 1], c22=c[:, 1, 1]), column["V_P"], column["T_P"])
        found = (np.abs(run.force).max(0), np.abs(run.u).max(0), run.energy[-1])
        for key, value in zip(("peak_force", "peak_elongation", "dissipated_energy"), found, strict=True):
            worst[f"{name} {key}"] = float(np.max(np.abs(value / column[key] - 1)))
    return worst


def against_scipy(effect: str | None, name: str, kind: str, size: float = 0.1, tolerance: float = 1e-8) -> float | None:
    """Largest difference of elongation and force from DOP853, over their largest values; None where it cannot be so large."""
    plan = draw(Case(kind, ((effect, name),) if effect else (), size, 0.0, 1, 0, 5))
    scales = respond(plan, np.zeros((0, 1)), Scales(1, 1, 1, 1), 1, FINE).scales(0, 1)
    delta = 0.0
    if effect:
        try:
            delta, scales = amplitude(plan, size, scales)
        except TooSmall:
            return None
    return difference(plan, delta, scales, respond(plan, [[delta]], scales, 1, FINE), tolerance)


def difference(plan: Plan, delta: float, scales: Scales, ours: Measured, tolerance: float = 1e-8) -> float:
    """Largest difference of the first experiment, last size of `ours` from DOP853, over the largest values."""
    kind, (x, y) = plan.kind, plan.inputs[0]
    specimen = Specimen(np.full(1, plan.A), np.full(1, plan.beta), scales)
    frame = Frame.nominal()
    for item in plan.hidden:
        if item.formula.place == "frame":
            frame = item.formula.act(frame, delta)
        else:
            specimen.acts.append((item.formula.act, {"delta": np.full(1, delta), **item.drawn}, item.formula.states))
    program = Program(np.array([x]), np.array([y]), DURATION)
    rates = driven_rates(specimen) if kind == "component" else shaken_rates(specimen, frame)

    def kinematics(t, state):
        if kind == "component":
            return tuple(part[0] for part in program(np.array([[t]])))
        return state[1] - state[0], state[3] - state[2]

    def flow(t, y):
        state, reach = y[:-2, None], y[-2:, None]
        u, v = kinematics(t, state)
        sample = (u, v) if kind == "component" else pulse(t, *plan.inputs[0])
        aside = np.array([u, -u]).ravel()
        grows = (aside >= reach[:, 0]) * np.maximum(np.array([v, -v]).ravel(), 0.0)
        return np.concatenate([rates(state, sample, reach)[:, 0], grows])

    units = np.concatenate([UNITS, np.full(specimen.rows - 8, 1e3), [0.1, 0.1]])
    solution = solve_ivp(
        flow, (0, DURATION), np.zeros(specimen.rows + 2), "DOP853", ours.time, rtol=tolerance, atol=tolerance * units,
        max_step=5e-3,
    )  # fmt: skip
    worst = 0.0
    force, elongation = np.empty(len(ours.time)), np.empty(len(ours.time))
    for i, t in enumerate(solution.t):
        state, reach = solution.y[:-2, i][:, None], solution.y[-2:, i][:, None]
        u, v = kinematics(t, state)
        elongation[i] = np.asarray(u).item()
        force[i] = np.asarray(specimen(u, v, state, reach)[0]).item()
    for mine, exact in ((ours.u[:, -1, 0], elongation), (ours.force[:, -1, 0], force)):
        worst = max(worst, float(np.max(np.abs(mine - exact)) / np.max(np.abs(exact))))
    return worst


def check() -> None:
    """Print the figures."""
    for key, value in against_reference().items():
        print(f"{key}: {value:.1e}")
    for kind in ("shaken", "component"):
        print(f"plain, {kind}: {against_scipy(None, '', kind):.1e}", flush=True)
        for (effect, name), formula in FORMULAS.items():
            if formula.place == "specimen" or (formula.place == "frame" and kind == "shaken"):
                if len(sys.argv) > 1 and sys.argv[1] != kind:
                    continue
                worst = against_scipy(effect, name, kind)
                print(f"{effect} ({name}), {kind}: {'too small' if worst is None else f'{worst:.1e}'}", flush=True)


if __name__ == "__main__":
    check()
