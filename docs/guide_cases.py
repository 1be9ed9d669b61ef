"""Makes the raw files of the guides, performs their hybrid simulations, and keeps the pictures of their runs.

    python docs/guide_cases.py raw FOLDER
    python docs/guide_cases.py perform RUN
    python docs/guide_cases.py pictures

`raw` writes the files of a laboratory: a cyclic test (`column`), a shaken frame (`frame`), ten coupons (`coupons`). `perform`
answers the requests that are out in a run folder, as a rig would.  `pictures` keeps figures of `runs/column`, `runs/frame`,
`runs/rig` and `runs/coupons` in `docs/images/guides`.

The specimens are a few lines of NumPy, which share no code with the package.  Each has something that the plain law lacks.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

G = 9.80665  # m/s²
STEPS = 20  # of an integration, between two samples
PICTURES = {
    "column": ("before_after", "cycles"),
    "frame": ("ranking", "before_after"),
    "rig": ("ranking", "fig6_exploration"),
    "coupons": ("population_bar", "before_after"),
}
IMAGES = Path(__file__).resolve().parent / "images" / "guides"


def yielding(way: np.ndarray, stiffness: float, strength: Callable[[float], float]) -> np.ndarray:
    """Force along imposed elongations of a spring that yields at a strength which depends on the absorbed energy.

    Between two points the force goes to the strength exponentially, which is Bouc and Wen's law with n = 1 and γ = 0.
    """
    force, energy = [0.0], 0.0
    for step in np.diff(way):
        limit = np.sign(step) * strength(energy)
        force.append(limit + (force[-1] - limit) * np.exp(-stiffness * step / limit) if step else force[-1])
        energy += 0.5 * (force[-1] + force[-2]) * step
    return np.array(force)


def cycles(amplitudes: list[float], samples: int) -> np.ndarray:
    """Elongations of one cycle at each amplitude, with `STEPS` of the integration to a sample."""
    phase = np.linspace(0.0, len(amplitudes), STEPS * samples * len(amplitudes) + 1)
    sizes = np.array([*amplitudes, amplitudes[-1]])[phase.astype(int)]
    return sizes * np.sin(2 * np.pi * phase)


def shaken(
    ground: np.ndarray,
    step: float,
    masses: list[float],
    force: Callable[[np.ndarray, np.ndarray], np.ndarray],
    rates: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    hidden: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Displacements relative to the ground, velocities and hidden states (rows: samples), and absolute accelerations.

    Runge and Kutta's method of fourth order with `STEPS` steps to a sample; the ground is a straight line between samples.
    """
    m, n = np.array(masses), len(masses)
    h, state, rows, accelerations = step / STEPS, np.zeros(2 * n + hidden), [], []

    def slope(y: np.ndarray, ag: float) -> np.ndarray:
        u, v, z = np.split(y, [n, 2 * n])
        return np.concatenate([v, -force(y[: 2 * n], z) / m - ag, rates(u, v, z)])

    for now, then in zip(ground, [*ground[1:], ground[-1]], strict=True):
        rows.append(state)
        accelerations.append(-force(state[: 2 * n], state[2 * n :]) / m)
        for i in range(STEPS):
            a, b, c = (now + (then - now) * (i + s) / STEPS for s in (0.0, 0.5, 1.0))
            k1 = slope(state, a)
            k2 = slope(state + h / 2 * k1, b)
            k3 = slope(state + h / 2 * k2, b)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(state + h * k3, c))
    return np.array(rows), np.array(accelerations)


def modal_damping(masses: list[float], stiffness: np.ndarray, ratio: float) -> np.ndarray:
    """The damping matrix [N s/m] with this share of critical damping in every mode."""
    root = np.sqrt(np.outer(masses, masses))
    squares, modes = np.linalg.eigh(stiffness / root)
    return root * ((modes * 2 * ratio * np.sqrt(squares)) @ modes.T)


def column(folder: Path) -> None:
    """A quasi-static cyclic test of a column that loses strength with the energy it absorbs."""
    u = cycles([5e-3, 10e-3, 10e-3, 20e-3, 20e-3, 30e-3, 30e-3, 40e-3, 40e-3, 50e-3], samples=48)
    force = yielding(u, 1.2e7, lambda e: 8.0e4 / (1 + 1.2e-5 * e))[::STEPS]
    noise = 800.0 * np.random.default_rng(1).standard_normal(force.size)
    table = pd.DataFrame({"displacement": 1e3 * u[::STEPS], "force": 1e-3 * (force + noise)})
    folder.mkdir(parents=True, exist_ok=True)
    table.round(4).to_csv(folder / "column.csv", index=False)


def frame(folder: Path) -> None:
    """Two motions of a shake table in a row; the lower storey yields and loses stiffness with the energy it absorbs."""
    random, step, k, strength, upper, masses = np.random.default_rng(2), 0.01, 1.2e6, 9.0e3, 1.6e6, [1.8e3, 1.5e3]
    t = np.arange(0.0, 6.0, step)
    motions = []
    for peak in (0.4, 0.5):
        noise = np.convolve(random.standard_normal(t.size), np.hanning(15), "same")
        motions.append(noise * (t / 2 * np.exp(1 - t / 2)) ** 2)
        motions[-1] *= peak * G / np.abs(motions[-1]).max()
    c = modal_damping(masses, np.array([[k + upper, -upper], [-upper, upper]]), 0.03)

    def force(y: np.ndarray, z: np.ndarray) -> np.ndarray:
        above = upper * (y[1] - y[0])
        return np.array([z[0] - above, above]) + c @ y[2:]

    def rates(u: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.array([k / (1 + 6e-4 * z[1]) * (v[0] - abs(v[0]) * z[0] / strength), z[0] * v[0]])

    ground = np.concatenate(motions)
    moved, accelerations = shaken(ground, step, masses, force, rates, hidden=2)
    columns = {"t": step * np.arange(ground.size), "table": ground / G}
    for floor in (0, 1):
        columns[f"d{floor + 1}"] = 1e3 * moved[:, floor] + 0.2 * random.standard_normal(ground.size)
        columns[f"a{floor + 1}"] = accelerations[:, floor] / G + 0.01 * random.standard_normal(ground.size)
    folder.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(columns).round(5).to_csv(folder / "shaking.csv", index=False)


def coupons(folder: Path) -> None:
    """Two coupons of each of five bars, of different strengths; all harden with the energy they absorb."""
    random, rows = np.random.default_rng(3), []
    (folder / "records").mkdir(parents=True, exist_ok=True)
    for bar, strength in zip("ABCDE", 4.2e8 * np.exp(0.06 * random.standard_normal(5)), strict=True):
        for number, amplitudes in ((1, [0.004, 0.008, 0.012, 0.016]), (2, [0.012, 0.012, 0.012, 0.012])):
            strain = cycles(amplitudes, samples=32)
            stress = yielding(strain, 2.0e11, lambda e, s=strength: s * (1.25 - 0.25 * np.exp(-e / 2.5e7)))[::STEPS]
            stress += 4e6 * random.standard_normal(stress.size)
            table = pd.DataFrame({"strain": 1e2 * strain[::STEPS], "stress": 1e-6 * stress})
            table.round(4).to_csv(folder / "records" / f"{bar}{number}.csv", index=False)
            rows.append({"id": f"{bar}{number}", "bar": bar, "split": "test" if bar == "E" else "train"})
    pd.DataFrame(rows).to_csv(folder / "experiments.csv", index=False)


def perform(run: Path) -> None:
    """The rig: the paper's structure, its specimen a spring that yields beside one that does not; record.csv per request."""
    masses, springs, k = [8.0e3, 9.0e3], np.diag([4.0e5, 1.0e6]), 5.0e5
    c = modal_damping(masses, springs + k * np.array([[1, -1], [-1, 1]]), 0.05)

    def specimen(y: np.ndarray, z: np.ndarray) -> float:
        return z[0] + 0.1 * k * (y[1] - y[0])

    def force(y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return springs @ y[:2] + c @ y[2:] + specimen(y, z) * np.array([-1.0, 1.0])

    def rates(u: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.array([k * (v[1] - v[0]) - abs(v[1] - v[0]) * z[0]])

    for request in sorted(run.glob("laboratory/*/request.json")):
        folder = request.parent
        if (folder / "record.csv").exists():
            continue
        motion = pd.read_csv(folder / "ground_motion.csv", comment="#")
        t, ground = motion.iloc[::8, 0].to_numpy(), motion.iloc[::8, 1].to_numpy()
        moved, _ = shaken(ground, float(t[1] - t[0]), masses, force, rates, hidden=1)
        random = np.random.default_rng(int("".join(filter(str.isdigit, folder.name))))
        du = moved[:, 1] - moved[:, 0] + 1e-3 * random.standard_normal(t.size)
        measured = np.array([specimen(row[:4], row[4:]) for row in moved]) + 1e3 * random.standard_normal(t.size)
        table = pd.DataFrame({"t": t, "du": 1e3 * du, "F": 1e-3 * measured})
        table.round(4).to_csv(folder / "record.csv", index=False)
        print(f"{json.loads(request.read_text())['id']}: {folder / 'record.csv'}")


def pictures() -> None:
    """Few colours in a palette: a quarter of the size."""
    from PIL import Image

    IMAGES.mkdir(exist_ok=True)
    for case, names in PICTURES.items():
        for name in names:
            picture = Image.open(Path("runs") / case / "figures" / f"{name}.png").convert("RGB")
            picture.quantize(64).save(IMAGES / f"{case}_{name}.png", optimize=True)


def main() -> None:
    """The three commands."""
    parser = argparse.ArgumentParser(description="Raw files and pictures of the guides.")
    parser.add_argument("what", choices=["raw", "perform", "pictures"])
    parser.add_argument("folder", nargs="?", type=Path, help="where to write (raw), or a run folder (perform)")
    given = parser.parse_args()
    if given.what == "pictures":
        pictures()
    elif given.folder is None:
        parser.error(f"{given.what} needs a folder")
    elif given.what == "perform":
        perform(given.folder)
    else:
        column(given.folder / "column")
        frame(given.folder / "frame")
        coupons(given.folder / "coupons")


if __name__ == "__main__":
    main()
