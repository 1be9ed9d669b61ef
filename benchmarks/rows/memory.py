"""Memory of a large batch through the public call, in a process of its own: `hx.simulate` of a million experiments."""

from pathlib import Path
from typing import Any

from fresh import alone
from measure import line

_MIB = 2.0**20
_WARM = 10_000


def measure(quick: bool) -> list[dict[str, Any]]:
    """The one line of this row."""
    count = 100_000 if quick else 1_000_000
    grown, data = alone(growth, count)
    what = f"hx.simulate of {count} experiments, quantities: growth of the peak resident memory"
    return [line("memory", what, "MiB", grown, {"its inputs and outputs": data})]


def growth(count: int) -> tuple[float, float]:
    """By how much `hx.simulate` raises the peak of this process, and the size of its inputs and outputs [MiB].

    A batch of 10 000 comes first, so that what imports and compilation need is not counted.
    """
    import jax
    import numpy as np
    from case import degrading, lanes

    import hsed_jax as hx

    case = degrading()
    study, free = case.study, case.mechanics.parameters[0]

    def simulated(count: int) -> float:
        values = lanes(case, count, seed=7)
        response = hx.simulate(
            study,
            {name: x for name, x in values.items() if name not in free},
            {name: x for name, x in values.items() if name in free},
            channels=(),
        )
        arrays = [np.asarray(x) for x in (*values.values(), *jax.tree.leaves(tuple(response)))]
        return sum(x.nbytes for x in arrays) / _MIB

    simulated(_WARM)
    before = _peak()
    data = simulated(count)
    return _peak() - before, data


def _peak() -> float:
    """Peak resident memory of this process so far [MiB]; unlike getrusage's, not that of the process it was forked from."""
    status = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    (entry,) = (entry for entry in status if entry.startswith("VmHWM:"))
    return float(entry.split()[1]) * 1024 / _MIB
