"""How many experiments tell two explanations apart?  `python benchmarks/rivals.py [--seeds N] [--resume]`

Twenty pairs of effects: the specimen of the paper's structure has the first, and both are explanations of what it does.  After
each experiment both models are fitted; a design stops where either has a probability above 0.95, or after ten chosen
experiments.  Designs differ in what they choose by, over seeds (noise of 10 % on three quantities, candidates): the expected log
Bayes factor (`discriminate`), the two classical criteria for rival models, from the same predictions (Box & Hill 1967; Hunter &
Reiner 1965), expected improvement, the variance of the Kriging model, Sobol's sequence, and chance.
"""

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import jax.numpy as jnp
import numpy as np
from case import PAPER

import hsed_jax as hx
from hsed_jax.design.acquisition import Given
from hsed_jax.diagnosis.rivals import predictive, separation
from hsed_jax.diagnosis.search import Search
from hsed_jax.study.build import Built
from hsed_jax.study.candidates import problem_of

RESULTS = Path(__file__).with_suffix(".json")
_RIVALS = (
    ("stiffness_degradation", "strength_degradation"),
    ("stiffness_degradation", "peak_softening"),
    ("viscous_damping", "quadratic_damping"),
    ("viscous_damping", "coulomb_friction"),
    ("viscous_damping", "rate_dependence"),
    ("hardening", "cubic_stiffness"),
    ("hardening", "isotropic_hardening"),
    ("pinching", "slip"),
    ("asymmetry", "quadratic_stiffness"),
    ("loop_shape", "yield_sharpness"),
)
# Of each pair the specimen has the one, and then the other.
PAIRS = [pair for one, other in _RIVALS for pair in ((one, other), (other, one))]
TOLD = ("discriminate", "box_hill", "hunter_reiner")
CHOOSERS = (*TOLD, "expected_improvement", "max_variance", "sobol", "random")
INITIAL, MOST, CERTAIN = 2, 10, 0.95
# Candidates that rivals are compared at.
_COMPARED = 128
_STRENGTH = 0.7
_COMMON = ("experiments.virtual.noise={relative: 0.1}", "error=null", "steps=[design]", "design.candidates=1024",
           f"design.initial={INITIAL}", f"design.iterations={MOST}", "calibration={sampler: laplace, starts: 2}")  # fmt: skip


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("choosers", nargs="*", metavar="CHOOSER", help=f"of {', '.join(CHOOSERS)} (default: all)")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="how many seeds of each pair (default: 20)")
    parser.add_argument("--resume", action="store_true", help="keep the designs that were made already")
    parser.add_argument("--markdown", action="store_true", help="the table of the last results, nothing measured")
    parser.add_argument("--output", type=Path, default=RESULTS, metavar="FILE.json")
    options = parser.parse_args()
    keeps = options.resume or options.markdown
    rows = json.loads(options.output.read_text(encoding="utf-8")) if keeps and options.output.exists() else []
    known = {(row["right"], row["rival"], row["by"], row["seed"]) for row in rows}
    # Pair by pair for one seed after the other: whoever stops early has all of them.
    todo = [(*pair, by, seed) for seed in range(options.seeds) for pair in PAIRS for by in options.choosers or CHOOSERS]
    for right, rival, by, seed in [] if options.markdown else todo:
        if (right, rival, by, seed) not in known:
            found = {"right": right, "rival": rival, "by": by, "seed": seed, **designed(right, rival, by, seed)}
            rows.append(found)
            print(found, flush=True)
            options.output.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(markdown(rows))


def designed(right: str, rival: str, by: str, seed: int) -> dict[str, Any]:
    """How many experiments one design takes, and the probability of what the specimen has at its end."""
    free = Built(hx.load_study(PAPER, [*_COMMON, f"model.effects.{right}={{}}"])).parameters[0]
    size = {n.split(".")[1]: float(p.quantile(_STRENGTH)) for n, p in free.items() if n.startswith(f"{right}.")}
    acquisition = "discriminate" if by in TOLD else by
    study = hx.load_study(PAPER, [*_COMMON, f"seed={seed}", f"design.acquisition={acquisition}",
                                  f"experiments.virtual.effects={{{right}: {json.dumps(size)}}}"])  # fmt: skip
    with tempfile.TemporaryDirectory() as folder, hx.AskTell(study, Path(folder) / "run") as design:
        built, last = design.built, {}

        def utilities(built: Built, campaign: hx.Campaign) -> Given:
            del built, campaign
            return Given(jnp.log(jnp.maximum(jnp.asarray(last["told"]), 1e-300)))

        with mock.patch("hsed_jax.runs.conduct.discriminate", utilities):
            while True:
                (asked,) = design.ask()
                measured = built.laboratory.perform(len(design.campaign) - 1, asked.si)
                design.conduct.tell(asked.id, measured)
                count = len(design.campaign)
                if count < INITIAL:
                    continue
                last = compared(built, design.campaign, right, rival, by)
                if max(last["probability"], 1 - last["probability"]) > CERTAIN or count == INITIAL + MOST:
                    return {"experiments": count, "probability": last["probability"]}


def compared(built: Built, campaign: hx.Campaign, right: str, rival: str, by: str) -> dict[str, Any]:
    """The probability of the right one of two explanations, and what each candidate is expected to tell of them."""
    cube = np.asarray(built.design.candidate_set[:_COMPARED])
    problem = problem_of(built, campaign, effects=(right, rival), cube=cube)
    search = Search(problem.models, problem.train, problem.law, problem.effects, lambda fit: False)
    search.start()
    search.run()
    models = [search.model({right}), search.model({rival})]
    shares = search.probabilities(models)
    told = None
    if by == "discriminate":
        told = separation(problem, search, models)
    elif by in TOLD:
        rows = problem.rows + np.arange(len(cube))
        (one, spread, _), (other, spread_other, _) = (predictive(problem, model, rows) for model in models)
        sigma = problem.sigma(search.errors, one)
        variances = [1 + np.sum((s / sigma[..., None]) ** 2, axis=2) for s in (spread, spread_other)]
        apart = ((one - other) / sigma) ** 2
        told = _box_hill(apart, *variances) if by == "box_hill" else np.sum(apart, axis=1)
    return {"probability": float(shares[0]), "told": told}


def _box_hill(apart: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Their upper bound on the change of entropy, without the probabilities, which are the same for all candidates."""
    return np.sum((one - other) ** 2 / (one * other) + apart * (1 / one + 1 / other), axis=1)


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """The table of the results."""
    heads = [
        "chosen by",
        "designs",
        "chosen experiments until certain, mean",
        "median",
        "certain of the right one",
        "of the wrong one",
    ]
    lines = [heads, ["---"] * len(heads)]
    for by in dict.fromkeys(row["by"] for row in rows):
        own = [row for row in rows if row["by"] == by]
        taken = np.asarray([row["experiments"] - INITIAL for row in own])
        right = np.mean([row["probability"] > CERTAIN for row in own])
        wrong = np.mean([row["probability"] < 1 - CERTAIN for row in own])
        lines.append(
            [f"`{by}`", str(len(own)), f"{taken.mean():.2f}", f"{np.median(taken):.3g}", f"{right:.0%}", f"{wrong:.0%}"]
        )
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


if __name__ == "__main__":
    main()
