"""Is the hidden effect among the first that are proposed?  `python benchmarks/proposals.py [GROUP ...]`.

The cases are those of `hidden_effects.py`. Of each the model as it is is fitted, and nothing else: the candidates are then in the
order of what they promise. The table says how often the hidden effect is among the first one, five, eight and ten of them; eight
are fitted.
"""

import argparse
import json
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from hidden.campaigns import TooSmall, make
from hidden.cases import Case
from hidden_effects import plan

from hsed_jax.config.load import load_study
from hsed_jax.diagnosis.candidates import problem_of
from hsed_jax.diagnosis.diagnose import noise_explains
from hsed_jax.diagnosis.propose import predicted_gains_of
from hsed_jax.diagnosis.search import Search
from hsed_jax.errors import UserError
from hsed_jax.study.build import Built

RESULTS = Path(__file__).with_suffix(".json")
_AMONG = (1, 5, 8, 10)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help="groups whose name contains this (default: all)")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="every N-th case of each group")
    parser.add_argument("--offset", type=int, default=0, metavar="N", help="from this case of each group on")
    parser.add_argument("--output", type=Path, default=RESULTS, metavar="FILE.json")
    parser.add_argument("--markdown", action="store_true", help="print the table of the last results, measure nothing")
    options = parser.parse_args()
    if options.markdown:
        print(table(json.loads(options.output.read_text(encoding="utf-8"))))
        return
    rows = []
    for group, cases in plan().items():
        if "control" in group or (options.groups and not any(word in group for word in options.groups)):
            continue
        for case in cases[options.offset :: options.stride]:
            if (row := row_of(case)) is not None:
                rows.append({"group": group, **row})
                print(rows[-1], file=sys.stderr, flush=True)
                options.output.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(table(rows))


def row_of(case: Case) -> dict[str, Any] | None:
    """The places of the hidden effects among all that are proposed, from one on; None where no campaign can be made."""
    with tempfile.TemporaryDirectory() as place:
        campaign = Path(place) / "campaign"
        try:
            make(case, campaign, Path(place) / "truth.json")
            built = Built(load_study(campaign / "study.yaml"))
            assert built.experiments.measured is not None
            problem = problem_of(built, built.experiments.measured)
        except (TooSmall, UserError):
            return None
        explained = partial(noise_explains, problem)
        search = Search(problem.models, problem.train, problem.law, problem.effects, explained, start=problem.start)
        search.start()
        begin = time.process_time()
        fit = search.model(()).fit
        order = list(predicted_gains_of(search.models, search.standard.target, fit, search.effects, explained(fit)))
    return {
        "hidden": [f"{effect}: {formula}" for effect, formula in case.effects],
        "kind": case.kind,
        "places": [order.index(effect) + 1 for effect, _ in case.effects],
        "of": len(order),
        "first": order[:5],
        "cpu_seconds": round(time.process_time() - begin, 2),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """By group and kind of campaign how often the hidden effect (of a pair: one of them) is among the first."""
    lines = [
        "| group | kind | cases | " + " | ".join(f"among {n}" for n in _AMONG) + " |",
        "|---" * (3 + len(_AMONG)) + "|",
    ]
    for group, kind in dict.fromkeys((row["group"], row["kind"]) for row in rows):
        places = [min(row["places"]) for row in rows if (row["group"], row["kind"]) == (group, kind)]
        shares = [f"{sum(place <= n for place in places)}" for n in _AMONG]
        lines.append(f"| {group} | {kind} | {len(places)} | " + " | ".join(shares) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
