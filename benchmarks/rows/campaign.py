"""The whole of the paper, as a user starts it: cold and warm, every step of it, and how soon the command answers."""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from case import PAPER
from measure import line

_NEIGHBOURS = 3
_SLOW = 5.0
_HSED = ("-c", "import sys; from hsed_jax.run import main; sys.exit(main())")


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row."""
    overrides = ("design.iterations=4",) if quick else ()
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder) / "cache"
        for state in ("cold", "warm"):
            output = Path(folder) / state
            wall, cpu = _taken(cache, "-m", "hsed_jax.run", str(PAPER), *overrides, "--output", str(output))
            steps = _steps(output)
            slow = recompiled(steps)
            lines.append(
                line(
                    "campaign",
                    f"the paper's run, 3 + {len(steps)} experiments, {state}",
                    "s",
                    wall,
                    {"cold": lines[0]["ours"]} if lines else {},
                    {
                        "ours": {
                            "CPU s": cpu,
                            "median step s": statistics.median(steps),
                            "steps that compile": len(slow),
                        }
                    },
                    tuple(f"{state}: step {n} took {steps[n]:.2f} s, as if it compiled" for n in slow),
                )
            )
        for name, arguments in _ANSWERS.items():
            wall, cpu = min(_taken(cache, *arguments) for _ in range(3))
            lines.append(line("campaign", name, "s", wall, {}, {"ours": {"CPU s": cpu}}))
    return lines


_ANSWERS = {"hsed --help": (*_HSED, "--help"), "hsed check paper.yaml": (*_HSED, "check", str(PAPER))}


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


def _taken(cache: Path, *arguments: str) -> tuple[float, float]:
    """Wall and CPU seconds of a Python of its own, the compilation cache in a folder of its own."""
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(cache)}
    before = os.times()
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True, env=environment)
    after = os.times()
    cpu = sum(after[2:4]) - sum(before[2:4])  # of children, user and system
    return after.elapsed - before.elapsed, cpu


def _steps(run: Path) -> list[float]:
    events = [json.loads(entry) for entry in (run / "journal.jsonl").read_text(encoding="utf-8").splitlines()]
    return [event["seconds"] for event in events if event["event"] == "step"]
