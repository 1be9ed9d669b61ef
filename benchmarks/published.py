"""What is learned from measured specimens that lie in a folder?  `python benchmarks/published.py [--data FOLDER]`

Every campaign with a held-out part is taken as a stranger would take it: `hsed init` writes the study, `hsed run` calibrates
the plain law, names what it lacks and adds it; nothing is told by hand, and no case by its name. With `--discover` it also
learns what no name is for. With `--files` the cases are raw files of laboratories, which `hsed init FILE` opens. Errors are
those of the run's improvement, on all samples. Seconds are those of the whole run in a new process, to its report. Beside the
error on the held-out part stand those of generic tools on the same samples: the same law by SciPy's least squares, and two
black boxes that know the history of the elongation (`peers/generic.py`). Errors are root mean squares in units of what was
measured, about its mean. The table ends with what `bouc_wen.py` found last, which has a published figure beside it: of the
specimens none is known that is of a part nothing was fitted to.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import bouc_wen
import numpy as np
from peers.generic import Cyclic, black_box_errors, least_squares_error
from run import machine

import hsed_jax as hx

RESULTS = Path(__file__).with_suffix(".json")
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
_DISCOVER = ("steps=[calibrate, compare, diagnose, discover, improve]",)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "cases", nargs="*", metavar="CASE", help="folders of the data (default: all that can be judged)"
    )
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER", help="holds the folders of the campaigns")
    parser.add_argument(
        "--pictures", type=Path, metavar="FOLDER", help="draw the loops of every case there, before and after"
    )
    parser.add_argument(
        "--files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="raw files in place of campaigns; no generic tools beside them",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        metavar="LIMIT",
        help="give up a case after so long, which its row says (default: never)",
    )
    parser.add_argument("--discover", action="store_true", help="learn what no name is for, too, which takes minutes")
    parser.add_argument("--resume", action="store_true", help="keep the cases that were measured already")
    parser.add_argument("--markdown", action="store_true", help="the table of the last results, nothing measured")
    parser.add_argument(
        "--draw", type=Path, metavar="FILE.png", help="draw the errors of the last results, nothing measured"
    )
    parser.add_argument("--output", type=Path, default=RESULTS, metavar="FILE.json")
    options = parser.parse_args()
    if options.draw is not None:
        draw(json.loads(options.output.read_text(encoding="utf-8"))["rows"], options.draw)
        return
    keeps = options.resume or options.markdown
    rows = json.loads(options.output.read_text(encoding="utf-8"))["rows"] if keeps and options.output.exists() else []
    if not options.markdown:
        known = [row["case"] for row in rows]
        overrides = _DISCOVER if options.discover else ()
        for case in options.files or judged(options.data, options.cases):
            if case.stem in known:
                continue
            rows.append(row_of(case, options.pictures, overrides, options.seconds))
            results = {"machine": machine(), "rows": rows}
            options.output.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(markdown(rows if options.files else [*rows, bouc_wen.in_units_of_the_signal()]))


def judged(data: Path, wanted: Sequence[str]) -> list[Path]:
    """The folders of the component tests with a held-out part."""
    folders = [path.parent for path in sorted(data.glob("*/campaign.yaml")) if not wanted or path.parent.name in wanted]
    campaigns = {folder: hx.read_campaign(folder) for folder in folders}
    return [f for f, c in campaigns.items() if c.protocol == "displacement" and len(c.test)]


def row_of(case: Path, pictures: Path | None, overrides: Sequence[str], limit: float | None) -> dict[str, Any]:
    """What comes out of a campaign or a raw file; its loops before and after are drawn where there is a folder for pictures."""
    with tempfile.TemporaryDirectory() as place:
        work = Path(place) / case.stem
        try:
            if case.is_dir():
                shutil.copytree(case, work)
                _hsed("init", work, "--output", work / "study.yaml")
            else:
                _hsed("init", shutil.copy(case, place))
            begin = time.perf_counter()
            _hsed("run", work / "study.yaml", *overrides, "--output", work / "run", limit=limit)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as failure:
            said = f"no end after {limit:.0f} s" if isinstance(failure, subprocess.TimeoutExpired) else failure.stderr
            return {"case": case.stem, "failed": said.strip().splitlines()[-1]}
        seconds = time.perf_counter() - begin
        summary = json.loads((work / "run" / "summary.json").read_text(encoding="utf-8"))
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            shutil.copy(work / "run" / "figures" / "before_after.png", pictures / f"{case.stem}.png")
        campaign = hx.read_campaign(work)
    generic: dict[str, float] = {}
    if case.is_dir():
        train, test = ([_cyclic(e) for e in part] for part in (campaign.train, campaign.test))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of scikit-learn, about its own bounds
            generic = {"least squares": least_squares_error(train, test), **black_box_errors(train, test)}
    found, learned = summary["diagnosis"], summary.get("discovery", {"found": False, "reason": "not looked for"})
    trail = summary["improvement"]["steps"]
    return {
        "case": case.stem,
        "noise": found["noise_floor"],
        "plain": trail[0]["error_test"],
        "named": next(s["error_test"] for s in trail[::-1] if set(s["effects"]) <= set(found["effects"])),
        "verdict": found["verdict"],
        "effects": found["effects"],
        "forms": {c["effect"]: c["form"] for c in found["ranking"] if c["effect"] in found["effects"] and "form" in c},
        "learned": learned["error_test"] if learned["found"] else None,
        "learning": f"{_place(learned['place'])}: {learned['formula']}" if learned["found"] else learned["reason"],
        "generic": generic,
        "seconds": seconds,
        "behaviour": found.get("behaviour_sentence", ""),
    }


def _hsed(*words: str | Path, limit: float | None = None) -> None:
    """A command of the package in a process of its own, of whose progress nothing is shown."""
    command = [sys.executable, "-m", "hsed_jax", *map(str, words)]
    subprocess.run(command, check=True, capture_output=True, text=True, timeout=limit)


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """A picture of the errors on the held-out part: plain law, with the named effects, noise; the worst specimen on top."""
    import matplotlib.pyplot as plt

    ranked = sorted((row for row in rows if "failed" not in row), key=lambda row: row["named"])
    names = [row["case"].replace("_", " ") for row in ranked]
    figure, axes = plt.subplots(figsize=(7.2, 2.4), layout="constrained")
    axes.hlines(names, [row["noise"] for row in ranked], [row["plain"] for row in ranked], color="0.8", zorder=0)
    marks = (
        ("plain", "plain law", "s", "0.45"),
        ("named", "with the named effects", "o", "C0"),
        ("noise", "noise", "|", "k"),
    )
    for key, label, marker, colour in marks:
        axes.scatter([row[key] for row in ranked], names, 48, color=colour, marker=marker, label=label)
    axes.set(xscale="log", xlabel="error on the part of the test that was not fitted (1: as bad as the mean)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper right", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)


def _place(place: Mapping[str, Any]) -> str:
    return f"{place['slot']} of {' × '.join(place['of'])}"


def _cyclic(experiment: hx.Experiment) -> Cyclic:
    record = experiment.record
    assert record is not None
    return Cyclic(*(np.asarray(record[name]) for name in ("elongation", "force")), np.asarray(experiment.in_window))


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table of the results."""
    rows, failed = [row for row in rows if "failed" not in row], [row for row in rows if "failed" in row]
    generic = list(dict.fromkeys(name for row in rows for name in row["generic"]))
    heads = ["specimen", "noise", "plain law", *generic, "with what is named", "named", "verdict", "with what is learned",
             "best published", "s"]  # fmt: skip
    lines = [heads, ["---"] * len(heads)]
    for row in rows:
        named = ", ".join(f"`{e}`" + (f" ({row['forms'][e]})" if e in row["forms"] else "") for e in row["effects"])
        errors = [
            _error(row["plain"]),
            *(_error(row["generic"].get(name)) for name in generic),
            f"**{_error(row['named'])}**",
        ]
        about = [named or "–", f"`{row['verdict']}`", _error(row["learned"]), _error(row.get("published"))]
        lines.append([row["case"].replace("_", " "), _error(row["noise"]), *errors, *about, f"{row['seconds']:.0f}"])
    lines += [[row["case"].replace("_", " "), row["failed"], *[""] * (len(heads) - 2)] for row in failed]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _error(value: float | None) -> str:
    """Three decimals, or two digits of what is smaller than these can tell."""
    return "–" if value is None else f"{value:.3f}" if value >= 1e-3 else f"{value:.1e}"


if __name__ == "__main__":
    main()
