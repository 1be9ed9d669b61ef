"""The whole of the paper, as a user starts it: cold and warm, every step of it, and how soon the command answers."""

import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from fresh import HSED, alone, soonest, taken, write_byte_code
from measure import line

PAPER = Path(__file__).resolve().parents[2] / "configs" / "paper.yaml"
_NEIGHBOURS = 3
_SLOW = 5.0
# What answers at once: its arguments, its exit status, and what it cannot do without.
_ANSWERS = {
    "hsed --help": (("--help",), 0, "Python alone", "pass"),
    "hsed check paper.yaml": (("check", str(PAPER)), 0, "imports of JAX and Equinox", "import equinox, jax"),
    "hsed check, a wrong key refused": (
        ("check", str(PAPER), "calibration.chain=4"),
        2,
        "imports of NumPy and pydantic",
        "import numpy, pydantic, yaml",
    ),
}


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row: wall seconds on all cores."""
    iterations = 4 if quick else 40
    settings = (f"design.iterations={iterations}",)
    write_byte_code()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lines = _started(folder, settings)
        wall, cpu = soonest(folder / "cache", *HSED, "report", str(folder / "warm"))
        lines.append(line("campaign", "hsed report of that run", "s", wall, {}, {"ours": {"CPU s": cpu}}))
        for what, (arguments, status, peer, work) in _ANSWERS.items():
            wall, cpu = soonest(folder / "cache", *HSED, *arguments, status=status)
            cost = {peer: soonest(folder / "cache", "-c", work)[0]}
            lines.append(line("campaign", what, "s", wall, cost, {"ours": {"CPU s": cpu}}))
        lines += _maximum_alone(folder / "laplace", settings, iterations)
        lines += _by_importance(folder / "importance", settings, iterations)
    return lines


def _started(folder: Path, settings: tuple[str, ...]) -> list[dict[str, Any]]:
    """The command, figures and report included."""
    lines = []
    for state in ("cold", "warm"):
        output = folder / state
        command = ("-m", "hsed_jax.run", str(PAPER), *settings, "--output", str(output))
        wall, cpu = taken(folder / "cache", *command)
        steps = _steps(output)
        slow = recompiled(steps)
        figures = {"CPU s": cpu, "median step s": statistics.median(steps), "steps that compile": len(slow)}
        lines.append(
            line(
                "campaign",
                f"the paper's run, 3 + {len(steps)} experiments, {state}",
                "s",
                wall,
                {"cold": lines[0]["ours"]} if lines else {},
                {"ours": figures},
                tuple(f"{state}: step {n} took {steps[n]:.2f} s, as if it compiled" for n in slow),
            )
        )
    return lines


def _maximum_alone(folder: Path, settings: tuple[str, ...], iterations: int) -> list[dict[str, Any]]:
    """`hx.run` with the MAP and the Gaussian around it, against the expert's script, which has the MAP alone."""
    found = _in_python(folder, (*settings, "calibration.sampler=laplace"))
    cost, maps, notes = _experts(iterations)
    accuracy = {
        who: {"MAP from ours [%]": 100 * max(abs(estimates[name] / value - 1) for name, value in found["map"].items())}
        for who, estimates in maps.items()
    }
    what = f"the paper's loop by hx.run, MAP alone, 3 + {iterations} experiments"
    return [
        line("campaign", f"{what}, {state}", "s", wall, cost, {"ours": found["figures"], **accuracy}, notes)
        for state, wall in found["seconds"].items()
    ]


def _by_importance(folder: Path, settings: tuple[str, ...], iterations: int) -> list[dict[str, Any]]:
    """`hx.run` with a posterior by importance sampling at every step."""
    found = _in_python(folder, (*settings, "calibration.sampler=importance"))
    what = f"the paper's loop by hx.run, importance sampling, 3 + {iterations} experiments"
    return [
        line("campaign", f"{what}, {state}", "s", wall, {}, {"ours": found["figures"]})
        for state, wall in found["seconds"].items()
    ]


def _in_python(folder: Path, settings: tuple[str, ...]) -> dict[str, Any]:
    """Wall seconds of `hx.run` by what was there before it, without the imports, which are among the figures."""
    first = alone(runs, folder / "first", settings, 2, cache=folder / "cache")
    second = alone(runs, folder / "second", settings, 1, cache=folder / "cache")
    return {
        "seconds": {
            "compilation cache empty": first["seconds"][0],
            "new process, cache filled": second["seconds"][0],
            "again in the same process": first["seconds"][1],
        },
        "figures": {"imports s": second["imports"]},
        "map": second["map"],
    }


def runs(folder: Path, settings: tuple[str, ...], count: int) -> dict[str, Any]:
    """Run the paper's study so often in this process, without figures: wall seconds of imports and of each run, and the MAP."""
    begin = time.perf_counter()
    import hsed_jax as hx

    run, study = hx.run, hx.load_study(PAPER, settings)
    imports = time.perf_counter() - begin
    taken, found = [], {}
    for number in range(count):
        begin = time.perf_counter()
        done = run(study, folder / f"{number}", progress=False, figures=False)
        taken.append(time.perf_counter() - begin)
        assert done.calibration is not None
        found = done.calibration.map
    return {"imports": imports, "seconds": taken, "map": found}


def _experts(iterations: int) -> tuple[dict[str, float], dict[str, dict[str, float]], tuple[str, ...]]:
    """Wall seconds of the expert's script, compiled beforehand, and its MAP."""
    # Not before: this process only starts others until now.
    from case import built
    from peers import expert, jitted, native, surrogate

    if not surrogate.is_there():
        return {}, {}, (surrogate.NOTE,)
    case, notes, cost, maps = built(), [], {}, {}
    for name, module in (("C + scikit-learn", native), ("numba + scikit-learn", jitted)):
        simulate = module.compiled()
        if simulate is None:
            notes.append(module.NOTE)
            continue
        expert.campaign(case, simulate, 1)
        begin = time.perf_counter()
        maps[name] = expert.campaign(case, simulate, iterations)
        cost[name] = time.perf_counter() - begin
    return cost, maps, tuple(notes)


def recompiled(seconds: list[float]) -> list[int]:
    """Steps after the first that took more than five times the median of the steps around them."""
    slow = []
    for n in range(1, len(seconds)):
        around = [
            seconds[m] for m in range(max(1, n - _NEIGHBOURS), n + _NEIGHBOURS + 1) if m != n and m < len(seconds)
        ]
        if around and seconds[n] > _SLOW * statistics.median(around):
            slow.append(n)
    return slow


def _steps(run: Path) -> list[float]:
    events = [json.loads(entry) for entry in (run / "journal.jsonl").read_text(encoding="utf-8").splitlines()]
    return [event["seconds"] for event in events if event["event"] == "step"]
