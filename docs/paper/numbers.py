"""The numbers of the paper, from the stored results of the benchmarks: `python docs/paper/numbers.py`.

Its figure is `docs/images/before_after.png`, drawn by `hsed run configs/hidden_effect.yaml` (`figures/before_after.png`).
"""

import json
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
GROUPS = ("same formula, strong", "other formula, strong", "pairs, medium", "control: nothing is missing")


def numbers() -> dict[str, str]:
    """What the paper says, by what it is of; a case counts where the noise does not explain the residual."""
    cases = json.loads((BENCHMARKS / "hidden_effects.json").read_text(encoding="utf-8"))
    found = {}
    for group in GROUPS:
        of_group = [case for case in cases if case["group"] == group]
        found[f"{group}: cases"] = str(len(of_group))
        found[f"{group}: exactly the hidden effects named"] = str(sum(bool(case.get("exact")) for case in of_group))
        found[f"{group}: something named"] = str(sum(bool(case.get("named")) for case in of_group))
    rows = json.loads((BENCHMARKS / "bouc_wen.json").read_text(encoding="utf-8"))["rows"]
    return found | {f"Bouc-Wen benchmark, {row['model']}": f"{row['test']:.1e} m" for row in rows}


if __name__ == "__main__":
    for what, number in numbers().items():
        print(f"{what}: {number}")
