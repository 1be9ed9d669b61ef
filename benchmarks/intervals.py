"""Do intervals cover, p-values keep their promise, draws have their tails; are there false alarms; how small an effect is seen?

    python benchmarks/intervals.py [--campaigns N] [--only intervals p_values alarms power tails] [--processes P] [--resume]
                                  [--markdown]

Campaigns of the paper's structure with a known truth, under noises of several kinds; nothing of the noise is told but its size.
The tails are those of a posterior of eight parameters that lean on their bounds, of two component tests, by NUTS against a long
reference (`peers/ensemble.py`), in ten campaigns.
Results go to `intervals.json` beside this file, from which `--markdown` prints the tables; `--resume` adds the campaigns that
they lack, which is right as long as the package is the same.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import signal

RESULTS = Path(__file__).with_suffix(".json")
STUDY = Path(__file__).parents[1] / "configs" / "paper.yaml"
TRUE = {"A": 5e5, "beta": 1.0}
ETA = 2e-5
# Campaigns that one job looks at.
CHUNK = 10
# Steps of the reference of the tails, and its campaigns.
_STEPS, _TAILS = 4000, 10
LEANING = {
    "study": "tails",
    "excitation": {"imposed": {"amplitudes": [0.05, 0.1, "a"], "cycles": 1, "rate": 0.2}},
    "inputs": {"a": {"uniform": [0.15, 0.25], "unit": "m"}},
    "model": {
        "spring": "bouc_wen",
        "parameters": {
            "A": {"uniform": [2.0e5, 9.0e5]},
            "beta": {"uniform": [0.5, 2.0]},
            "gamma": {"uniform": [-0.5, 0.5]},
            "n": {"uniform": [0.9, 1.2]},
        },
        "effects": {
            name: {} for name in ("stiffness_degradation", "strength_degradation", "hardening", "viscous_damping")
        },
    },
    "experiments": {
        "virtual": {
            "parameters": {"A": 5.0e5, "beta": 1.0, "gamma": 0.0, "n": 1.0},
            "effects": {"stiffness_degradation": {"eta": 1.0e-6}},
            "noise": {"relative": 0.03},
        }
    },
    "observe": "histories",
    "steps": ["calibrate"],
    "design": {"initial": 2},
    "calibration": {"sampler": "nuts"},
}
"""Whose posterior of eight parameters leans on several bounds."""


class Noise(NamedTuple):
    """Noise of the measurements: of quantities or histories, its relative size, and its colour.

    Attributes:
        observe: quantities or histories.
        level: relative standard deviation.
        colour: white, t5, or an autoregression: its correlation from sample to sample.
    """

    observe: str
    level: float
    colour: float | str = "white"

    def series(self, random: np.random.Generator, size: int) -> np.ndarray:
        """Noise of unit variance."""
        if self.colour == "t5":
            return random.standard_t(5, size) / np.sqrt(5 / 3)
        rho = 0.0 if self.colour == "white" else float(self.colour)
        news = np.sqrt(1 - rho**2) * random.standard_normal(size)
        news[0] /= np.sqrt(1 - rho**2)
        return signal.lfilter([1.0], [1.0, -rho], news)

    def __str__(self) -> str:
        colour = self.colour if isinstance(self.colour, str) else f"AR(1) {self.colour:.3g}"
        return f"{self.observe}, {self.level:.0%}" + (f", {colour}" if self.observe == "histories" else "")


class Case(NamedTuple):
    """A kind of campaign: its noise, how many experiments of how many seconds, and the effect hidden in the specimen."""

    noise: Noise
    experiments: int
    seconds: float
    eta: float = 0.0


def _memory(times: int) -> float:
    """ρ that makes a record of 6 s, 385 samples, so many integrated correlation times long."""
    tau = 385 / times
    return (tau - 1) / (tau + 1)


WHITE = Noise("histories", 0.05)
INTERVALS = [
    *(Case(Noise("quantities", level), number, 10.0, ETA) for number in (6, 43) for level in (0.05, 0.1, 0.2)),
    *(Case(noise, 4, 6.0, ETA) for noise in (WHITE, *(Noise("histories", 0.05, _memory(t)) for t in (82, 33, 10)))),
]
TRUE_MODEL = [
    *(Case(Noise("quantities", level), 6, 6.0) for level in (0.05, 0.1, 0.2)),
    *(Case(Noise("histories", 0.05, colour), 4, 6.0) for colour in ("white", "t5", 0.1, 0.5, 0.9)),
]
POWER = [Case(WHITE, 4, 6.0, eta) for eta in (5e-8, 1e-7, 2e-7, 4e-7, 1e-6)]


@cache
def clean(case: Case):
    """The campaign without noise."""
    import hsed_jax as hx
    from hsed_jax.analysis.calibration import campaign_of

    return campaign_of(hx.load_study(STUDY, [*_common(case), f"experiments.virtual.effects={_hidden(case)}"]))


@cache
def built(case: Case, effects: str):
    """The study of such a campaign."""
    import hsed_jax as hx
    from hsed_jax.study.build import Built

    sizes = ["calibration.sampler=importance", "calibration.draws=100"]
    told = [f"error={{relative: {case.noise.level}}}", f"model.effects={effects}", *sizes]
    return Built(hx.load_study(STUDY, [*_common(case), *told]), clean(case))


def noisy(case: Case, seed: int):
    """The campaign with noise."""
    from hsed_jax.measurements import Record

    random, campaign, noise = np.random.default_rng(seed), clean(case), case.noise
    for e in campaign:
        if noise.observe == "quantities":
            shaken = {
                name: value * (1 + noise.level * random.standard_normal()) for name, value in e.quantities.items()
            }
            campaign = campaign.update(replace(e, quantities=shaken))
            continue
        channels = dict(e.record.channels)
        for name in ("force", "elongation"):
            size = noise.level * np.sqrt(np.mean(channels[name] ** 2))
            channels[name] = channels[name] + size * noise.series(random, len(e.record))
        campaign = campaign.update(replace(e, record=Record(e.record.time, channels)))
    return campaign


def _common(case: Case) -> list[str]:
    return [
        "steps=[calibrate]",
        f"observe={case.noise.observe}",
        f"design.initial={case.experiments}",
        f"excitation.duration={case.seconds}",
    ]


def _hidden(case: Case) -> str:
    return f"{{stiffness_degradation: {{eta: {case.eta}}}}}" if case.eta else "{}"


def intervals(case: Case, seeds: Sequence[int]) -> dict[str, list]:
    """Whether the 90 % interval of each parameter holds the truth, the effect's size included."""
    from hsed_jax.analysis.calibration import calibrate_built

    study, name = built(case, "{stiffness_degradation: {eta: {half_normal: 1e-4}}}"), "stiffness_degradation.eta"
    found: dict[str, list] = {"A": [], "beta": [], "size": []}
    for seed in seeds:
        told = calibrate_built(study, noisy(case, seed)).fit.summary()
        for key, parameter, truth in (("A", "A", TRUE["A"]), ("beta", "beta", TRUE["beta"]), ("size", name, case.eta)):
            found[key].append(told[parameter]["q05"] < truth < told[parameter]["q95"])
    return found


def p_values(case: Case, seeds: Sequence[int]) -> dict[str, list]:
    """p-values of the calibrated true model."""
    from hsed_jax.analysis.calibration import calibrate_built

    return {"p": [calibrate_built(built(case, "{}"), noisy(case, seed)).fit.p_value for seed in seeds]}


def diagnoses(case: Case, seeds: Sequence[int]) -> dict[str, list]:
    """Verdicts, what was named, and the p-value of the residual."""
    import hsed_jax as hx
    from hsed_jax.analysis.calibration import calibrate_built

    verdicts, named, values = [], [], []
    for seed in seeds:
        calibration = calibrate_built(built(case, "{}"), noisy(case, seed))
        found = hx.diagnose(calibration)
        verdicts.append(found.verdict)
        named.append(found.effects)
        values.append(calibration.fit.p_value)
    return {"verdict": verdicts, "effects": named, "p": values}


def tails(case: Case, seeds: Sequence[int]) -> dict[str, list]:
    """By parameter, standard deviation and 5 % quantile of the draws, and of the reference; and their effective number."""
    import jax
    from peers.ensemble import walk

    import hsed_jax as hx
    from hsed_jax.analysis.calibration import calibrate_built, campaign_of
    from hsed_jax.physics.batch import TILE
    from hsed_jax.study.build import Built

    @jax.jit
    def heights(posterior, data, u):
        return jax.lax.map(lambda one: posterior.log_density(one, data), u, batch_size=TILE)

    found: dict[str, list] = {"draws": [], "reference": [], "ess": []}
    for seed in seeds:
        study = hx.load_study({**LEANING, "seed": seed})
        campaign = campaign_of(study)
        fit = calibrate_built(Built(study, campaign), campaign).fit
        posterior, data, maximum = fit.posterior, fit.data, fit.maximum

        def log_density(u, posterior=posterior, data=data):
            return np.nan_to_num(np.asarray(heights(posterior, data, u)), nan=-np.inf)

        frame = np.asarray(maximum.whitening)
        reference = walk(log_density, np.asarray(maximum.start), frame @ frame.T, _STEPS, seed)
        of_reference = jax.vmap(posterior.constrain)(reference.reshape(-1, len(posterior.names)))
        for key, draws in (("draws", fit.chains.theta), ("reference", of_reference)):
            table = np.asarray(draws).reshape(-1, len(posterior.names))
            found[key].append(
                {
                    n: [float(x.std()), float(np.quantile(x, 0.05))]
                    for n, x in zip(posterior.names, table.T, strict=True)
                }
            )
        found["ess"].append(float(fit.convergence.ess_bulk.min()))
    return found


PARTS = {
    "intervals": (intervals, INTERVALS),
    "p_values": (p_values, TRUE_MODEL),
    "alarms": (diagnoses, TRUE_MODEL),
    "power": (diagnoses, POWER),
    "tails": (tails, [Case(Noise("histories", 0.03), 2, 0.0)]),
}
MOST = {"tails": _TAILS}
"""Campaigns of the parts that have fewer."""


def measured(
    parts: list[str], campaigns: int, processes: int | None, known: dict[str, list[dict]]
) -> Iterator[dict[str, list[dict]]]:
    """What has been found of the cases of these parts, what is known included; every few campaigns of a case anew."""
    found: dict[str, list[dict]] = {
        part: [_begun(case, known.get(part, [])) for case in PARTS[part][1]] for part in parts
    }
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        # All cases go on side by side, so that tables of a run that was stopped are whole.
        asked = {
            pool.submit(PARTS[part][0], case, seeds): (row, seeds)
            for first in range(0, campaigns, CHUNK)
            for part in parts
            for case, row in zip(PARTS[part][1], found[part], strict=True)
            if (
                seeds := [
                    s
                    for s in range(first, min(first + CHUNK, campaigns, MOST.get(part, campaigns)))
                    if s not in row["seeds"]
                ]
            )
        }
        for job in as_completed(asked):
            row, seeds = asked[job]
            for key, values in {**job.result(), "seeds": seeds}.items():
                row.setdefault(key, []).extend(values)
            yield {part: [row for row in rows if row["seeds"]] for part, rows in found.items()}


def _about(case: Case) -> dict:
    return {"case": str(case.noise), "experiments": case.experiments, "eta": case.eta}


def _begun(case: Case, known: list[dict]) -> dict:
    """What is known of a case, or nothing yet."""
    about = _about(case)
    return next((dict(row) for row in known if about.items() <= row.items()), {**about, "seeds": []})


def tables(results: dict[str, list[dict]]) -> str:
    """The results as Markdown."""
    lines: list[str] = []

    def table(heads: tuple[str, ...], rows: list[tuple]) -> None:
        lines.extend(["| " + " | ".join(row) + " |" for row in (heads, ["---"] * len(heads), *rows)])
        lines.append("")

    def share(values) -> str:
        return f"{np.mean(values):.0%}"

    def begin(row: dict, counted: str) -> tuple[str, ...]:
        return row["case"], str(row["experiments"]), str(len(row[counted]))

    heads = ("noise", "experiments", "campaigns")
    if rows := results.get("intervals"):
        kinds = ("A", "beta", "size")
        table((*heads, *kinds), [(*begin(r, "A"), *(share(r[kind]) for kind in kinds)) for r in rows])
    if rows := results.get("p_values"):
        below = (0.01, 0.1)
        shares = [[share(np.asarray(r["p"]) < x) for x in below] for r in rows]
        table((*heads, *(f"p < {x}" for x in below)), [(*begin(r, "p"), *s) for r, s in zip(rows, shares, strict=True)])
    if rows := results.get("alarms"):
        wrong = [str(sum(v != "adequate" for v in r["verdict"])) for r in rows]
        table((*heads, "called wrong"), [(*begin(r, "verdict"), w) for r, w in zip(rows, wrong, strict=True)])
    for r in results.get("power", []):
        seen = share(np.asarray(r["p"]) < 0.01), share(["stiffness_degradation" in named for named in r["effects"]])
        if r is results["power"][0]:
            lines += ["| eta [1/J] | campaigns | p < 0.01 | named |", "| --- | --- | --- | --- |"]
        lines.append(f"| {r['eta']:.0e} | {len(r['p'])} | {seen[0]} | {seen[1]} |")
    if rows := results.get("tails"):
        lines += ["", *_of_tails(rows[0])]
    return "\n".join(lines)


def _of_tails(row: dict) -> list[str]:
    """Of each parameter over the campaigns, the draws' sd over the reference's, and how far their 5 % quantiles are apart."""
    lines = [
        "| parameter | sd over the reference's | 5 % quantile less the reference's, in sd |",
        "| --- | --- | --- |",
    ]
    for name in row["reference"][0]:
        own, true = (np.asarray([one[name] for one in row[key]]) for key in ("draws", "reference"))
        ratio, apart = own[:, 0] / true[:, 0], (own[:, 1] - true[:, 1]) / true[:, 0]
        told = (
            f"{np.median(x):{form}} ({x.min():{form}} to {x.max():{form}})"
            for x, form in ((ratio, ".2f"), (apart, "+.2f"))
        )
        lines.append(f"| {name} | {' | '.join(told)} |")
    return [
        *lines,
        "",
        f"Effective draws: {np.median(row['ess']):.0f} ({min(row['ess']):.0f} to {max(row['ess']):.0f}).",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=100, help="of each case")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to measure")
    parser.add_argument("--processes", type=int, help="at once; as many as cores if left out")
    parser.add_argument("--resume", action="store_true", help="add to what was measured")
    parser.add_argument("--markdown", action="store_true", help="print the tables of what was measured last")
    options = parser.parse_args()
    known = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if not options.markdown:
        for found in measured(options.only, options.campaigns, options.processes, known if options.resume else {}):
            known |= found
            RESULTS.write_text(json.dumps(known))
    print(tables(known))


if __name__ == "__main__":
    main()
