"""How often `hsed check` says each fault that is put into measured records, and how often it speaks where nothing is wrong.

`python benchmarks/doubts.py` writes `benchmarks/doubts.json` and prints the table of `docs/measurements.md`.  Five measured
component records get each fault in three sizes.  Clean are the same records, windows of them, synthetic loops of four laws
with noise, and windows of cyclic curves of stone masonry in which no rows are missing.  A unit that is wrong for a whole record
is looked for in two campaigns, one experiment of each after the other.
"""

import csv
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from hsed_jax.measurements import Campaign, Record, check_campaign, read_campaign
from hsed_jax.measurements.turns import turns
from hsed_jax.measurements.unit_doubts import factor_doubts

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FIVE = {"rc_column": "first_cycles", "timber_connection": "first_cycles", "steel_damper": "first_cycles",
        "friction_damper": "harmonic_025Hz", "steel_coupons": "A64"}  # fmt: skip
MISSING = {"FD_WI1100_Vasconcelos2009": 114, "FD_WS1250_Vasconcelos2009": 147}
"""Curves in which rows are missing: in one sample the elongation goes from 0.5 to -5.6 mm, and from -3.1 to -5.2 mm."""
UNITS = {"force": (9.80665, 1000.0, 4448.22), "elongation": (10.0, 25.4, 1000.0)}
"""Factors between units that are taken for one another."""
EVERY = 4  # experiments of a campaign of which one after the other is put into another unit
Loop = tuple[np.ndarray, np.ndarray]


def said(u: np.ndarray, f: np.ndarray) -> set[str]:
    """The kinds of doubts of a record without a time, in mm and kN."""
    record = {"elongation": 1e3 * u, "force": 1e-3 * f}
    units = {"elongation": "mm", "force": "kN"}
    campaign = Campaign.from_frames(records={"E1": record}, protocol="displacement", channels=units)
    return {finding.kind or finding.level for finding in check_campaign(campaign)}


def late(u: np.ndarray, f: np.ndarray, size: float) -> Loop:
    """The force comes later by a share of a cycle (negative: earlier)."""
    cycle = 2 * np.median(np.diff(turns(u)))
    lag = int(np.sign(size)) * max(1, round(abs(size) * cycle))
    return u, np.concatenate([np.full(lag, f[0]), f[:-lag]]) if lag > 0 else np.concatenate(
        [f[-lag:], np.full(-lag, f[-1])]
    )


def hold(u: np.ndarray, f: np.ndarray, size: float) -> Loop:
    """Held at the largest elongation for 60 samples while the force relaxes by a share."""
    at = int(np.argmax(np.abs(u[: -u.size // 10])))
    u, relaxed = np.insert(u, at, np.full(60, u[at])), np.insert(f, at, f[at] * np.linspace(1, 1 - size, 60))
    return u, relaxed


def slip(u: np.ndarray, f: np.ndarray, size: float) -> Loop:
    """A step back by a share of the range on the way to the largest elongation, and forward again."""
    at = int(np.argmax(u[: -u.size // 10])) - 2
    return np.concatenate([u[:at], u[at : at + 1] - size * np.ptp(u), u[at + 1 :]]), f


def cut(u: np.ndarray, f: np.ndarray, size: float) -> Loop:
    """Rows are missing where the elongation goes through a share of the range within the longest way."""
    found = turns(u)
    way = int(np.argmax(np.abs(np.diff(u[found]))))
    begin = int(0.5 * (found[way] + found[way + 1]))
    far = np.flatnonzero(np.abs(u[begin:] - u[begin]) > size * np.ptp(u))
    gone = slice(begin + 1, begin + int(far[0]))
    return np.delete(u, gone), np.delete(f, gone)


def scaled(u: np.ndarray, f: np.ndarray, size: float) -> Loop:
    """The elongation changes its unit by a factor at a third of a way."""
    found = turns(u)
    way = int(np.argmax(np.abs(np.diff(u[found])) * (np.diff(found) > 0)))
    begin = int(found[way] + (found[way + 1] - found[way]) // 3)
    return np.where(np.arange(u.size) < begin, u, u / size), f


def ramp(values: np.ndarray, size: float) -> np.ndarray:
    return values + size * np.abs(values).max() * np.linspace(0, 1, values.size)


FAULTS: dict[str, tuple[str, tuple[float, ...], Callable[[np.ndarray, np.ndarray, float], Loop]]] = {
    "force late, share of a cycle": ("timing", (0.02, 0.05, 0.1), late),
    "force early, share of a cycle": ("timing", (0.02, 0.05, 0.1), lambda u, f, s: late(u, f, -s)),
    "sign of the force": ("sign", (1.0, 1.0, 1.0), lambda u, f, s: (u, -s * f)),
    "drift of the force, share of the largest": ("drift", (0.1, 0.2, 0.4), lambda u, f, s: (u, ramp(f, s))),
    "drift of the elongation, share of the largest": ("drift", (0.1, 0.2, 0.4), lambda u, f, s: (ramp(u, s), f)),
    "offset of the elongation, share of the largest": ("offset", (0.03, 0.1, 0.3), lambda u, f, s: (u + s * np.abs(u).max(), f)),
    "slip, share of the range": ("slip", (0.04, 0.08, 0.12), slip),
    "hold, share of the force that relaxes": ("hold", (0.1, 0.2, 0.4), hold),
    "missing rows, share of the range": ("jump", (0.1, 0.2, 0.4), cut),
    "unit changes, factor": ("unit", (100.0, 1000.0, 25400.0), scaled),
    "force clipped, share of the largest": (
        "clipped", (0.9, 0.7, 0.5), lambda u, f, s: (u, np.clip(f, -s * np.abs(f).max(), s * np.abs(f).max())),
    ),
    "one branch, share of the record's first loading": (
        "monotonic",
        (0.5, 0.8, 1.0),
        lambda u, f, s: (np.linspace(0, s * np.abs(u).max(), 60), np.linspace(0, s * np.abs(f).max(), 60)),
    ),
}  # fmt: skip


def five() -> Iterator[tuple[str, Loop]]:
    for name, id in FIVE.items():
        record = read_campaign(DATA / name)[id].record
        assert record is not None
        yield name, (record["elongation"], record["force"])


def windows(name: str, loop: Loop, count: int) -> Iterator[tuple[str, Loop]]:
    """A record and its first parts, each to a turn."""
    u, f = loop
    found = turns(u)
    for part in range(1, count + 1):
        end = int(found[max(round(part * (found.size - 1) / count), min(4, found.size - 1))]) + 1
        yield f"{name} {part}/{count}", (u[:end], f[:end])


def synthetic() -> Iterator[tuple[str, Loop]]:
    """Elastic, elastoplastic, rounded and pinched loops with noise."""
    amplitudes = np.repeat([1, 2, 4, 6, 9, 12], 2)
    phase = np.arange(80 * amplitudes.size) / 80
    u = np.interp(phase % 1, [0, 0.25, 0.75, 1], [0, 1, -1, 0]) * amplitudes[phase.astype(int)] * 1e-3
    for seed in range(21):
        draw, law = np.random.default_rng(seed), seed % 4
        force = np.zeros_like(u)
        for i in range(1, u.size):
            step = u[i] - u[i - 1]
            rounding = (
                0.0
                if law == 0
                else (0.5 + 0.5 * np.sign(force[i - 1] * step)) * abs(force[i - 1] / 3e4) ** (20 if law == 1 else 1)
            )
            force[i] = force[i - 1] + 1e7 * step * (1 - rounding)
        if law == 3:
            force *= np.abs(u) / (np.abs(u) + 1e-3)
        yield (
            f"synthetic {seed}",
            (u + 1e-5 * draw.normal(size=u.size), force + 1e-3 * np.abs(force).max() * draw.normal(size=u.size)),
        )


def masonry() -> Iterator[tuple[str, Loop]]:
    """The first two fifths of the turns of the cyclic curves of one laboratory, but for those in which rows are missing."""
    for path in sorted((DATA / "stone_masonry" / "curves").glob("*_Vasconcelos2009.csv")):
        if path.stem in MISSING:
            continue
        lines = path.read_bytes().decode("latin-1").splitlines()[4:]
        rows = np.asarray(
            [[float(cell or "nan") for cell in line.split(",")[:2]] for line in lines if line.count(",") >= 1]
        )
        rows = rows[np.isfinite(rows).all(axis=1)]
        u, f = 1e-3 * rows[:, 0], 1e3 * rows[:, 1]
        end = int(turns(u)[max(round(0.4 * turns(u).size), 6)]) + 1
        yield path.stem, (u[:end], f[:end])


def campaigns() -> Iterator[tuple[str, Campaign]]:
    """Steel coupons, and a factorial of tests of a friction damper with its amplitudes as an input."""
    yield "24 steel coupons", read_campaign(DATA / "steel_coupons")
    folder = DATA / "friction_damper_factorial"
    with (folder / "experiments.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["amplitude"]]
    channels = {"time": "s", "elongation": "inch", "force": "kip"}
    records = {}
    for row in rows:
        table = np.loadtxt(folder / "records" / f"{row['id']}.csv", delimiter=",", skiprows=1)
        records[row["id"]] = dict(zip(channels, table.T, strict=True))
    inputs = {"amplitude": "inch", "tension": "lbf", "frequency": "Hz"}
    experiments = [{"id": row["id"], **{name: float(row[name]) for name in inputs}} for row in rows]
    yield (
        f"{len(rows)} tests of a friction damper",
        Campaign.from_frames(experiments, records, protocol="displacement", inputs=inputs, channels=channels),
    )


def doubted_units(campaign: Campaign) -> set[tuple[str, str]]:
    """Experiment and channel of every doubt of a unit that other experiments or an input tell."""
    return {(finding.experiment, finding.channel) for finding in factor_doubts(campaign)}


def found_units(campaign: Campaign, channel: str, factor: float) -> tuple[int, int, int]:
    """How many experiments in another unit are found, how many there are, and how often something else is doubted."""
    found, others, chosen = 0, 0, campaign.experiments[::EVERY]
    for k, experiment in enumerate(chosen):
        assert experiment.record is not None
        size = factor if k % 2 else 1 / factor
        channels = {n: (size if n == channel else 1.0) * v for n, v in experiment.record.channels.items()}
        wrong = campaign.update(replace(experiment, record=Record(experiment.record.time, channels)))
        doubts = doubted_units(wrong)
        found += (experiment.id, channel) in doubts
        others += bool(doubts - {(experiment.id, channel)})
    return found, len(chosen), others


def main() -> None:
    """Inject, check, count, print."""
    faults = {}
    for fault, (kind, sizes, inject) in FAULTS.items():
        found = [[kind in said(*inject(u.copy(), f.copy(), size)) for _, (u, f) in five()] for size in sizes]
        faults[fault] = {"kind": kind, "sizes": sizes, "said": [sum(row) for row in found], "of": len(FIVE)}
    clean = [*(w for name, loop in five() for w in windows(name, loop, 5)), *synthetic(), *masonry()]
    for number in range(64, 80):
        name = f"B{number}"
        campaign = read_campaign(DATA / "steel_coupons")
        if name in campaign and (record := campaign[name].record) is not None:
            clean.append((f"steel_coupons {name}", (record["elongation"], record["force"])))
    false = {name: sorted(kinds) for name, (u, f) in clean if (kinds := said(u, f))}
    units = {}
    for name, campaign in campaigns():
        false |= {name: sorted(map(str, doubts))} if (doubts := doubted_units(campaign)) else {}
        units[name] = {
            channel: {f"{factor:g}": found_units(campaign, channel, factor) for factor in factors}
            for channel, factors in UNITS.items()
        }
    result = {"faults": faults, "units": units, "clean": len(clean), "false": false}
    (Path(__file__).parent / "doubts.json").write_text(json.dumps(result, indent=1) + "\n")
    print("| fault | sizes | said as | small | medium | large |\n|---|---|---|---|---|---|")
    for fault, row in faults.items():
        sizes = ", ".join(f"{size:g}" for size in row["sizes"]) if len(set(row["sizes"])) > 1 else "–"
        print(
            f"| {fault} | {sizes} | `{row['kind']}` | " + " | ".join(f"{n} of {row['of']}" for n in row["said"]) + " |"
        )
    print("\n| campaign | channel | factor | found | something else is doubted |\n|---|---|---|---|---|")
    for name, channels in units.items():
        for channel, factors in channels.items():
            for factor, (found, count, others) in factors.items():
                print(f"| {name} | {channel} | {factor} | {found} of {count} | {others} |")
    print(f"\nAny doubt of {len(clean)} clean records: {len(false)} ({false})")


if __name__ == "__main__":
    main()
