"""The measured records of the board, and which of their rows a method may use.

A record is a raw file of a laboratory, which `hsed init` opens, or a campaign folder. A file that does not state its columns or
units gets the answers of its data set's description, the same for all files of the set. Two questions are asked of each record:

* `last rows`: the rows that the package itself holds out. Of a file it is the last third, of a campaign what its table says.
* `every third cycle`: cycles 3, 6, 9, ... of every test are left out, and all others are fitted.

A method knows the elongation of all rows and the force of the fitted rows. It simulates from the start of the test.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import hsed_jax as hx
from hsed_jax.measurements.checks import SAMPLES, stop_at_errors
from hsed_jax.measurements.thinning import thinned
from hsed_jax.measurements.turns import cycle_numbers

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
QUESTIONS = ("last rows", "every third cycle")
MOST_ROWS = 3000
"""A longer record is thinned to about so many rows, by the package's own rule."""

_FLOORS = range(1, 7)
# Masses are unknown, so the sum of the accelerations of equal floors stands for the force: errors are relative.
_BUILDING: dict[str, Any] = {
    "elongation": "d1 - du",
    "force": " ".join(f"- a{floor}" for floor in _FLOORS),
    "units": {"t": "s", "d1": "m", "du": "m", **{f"a{floor}": "kN" for floor in _FLOORS}},
}
_SETS: dict[str, dict[str, Any]] = {
    "stone_masonry/curves": {},
    "steel_specimens": {},
    "friction_damper_factorial/records": {"units": {"t": "s", "du": "inch", "F": "kip"}},
    "isolated_building/records": _BUILDING,
}


@dataclass(frozen=True)
class Specimen:
    """A raw file or a campaign folder.

    Attributes:
        source: the file or folder.
        group: the data set.
        said: what the description of the data set answers where the file leaves it open, as `hx.read_files` takes it.
    """

    source: Path
    group: str
    said: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The name of the row."""
        return self.source.stem

    def campaign(self) -> hx.Campaign:
        """Read the records.

        Raises:
            UserError: the file cannot be read, or no fitted record has a loop, as `hsed run` says it too.
        """
        one = hx.read_campaign(self.source) if self.source.is_dir() else hx.read_files(self.source, **self.said)
        stop_at_errors(one, needs_loops=True)
        return one

    @property
    def words(self) -> list[str]:
        """The answers, as `hsed init` takes them."""
        columns = [f"--{name}={self.said[name]}" for name in ("elongation", "force") if name in self.said]
        units = [word for item in self.said.get("units", {}).items() for word in ("--unit", "=".join(item))]
        return [*columns, *units]


@dataclass(frozen=True)
class Test:
    """One test under one question.

    Attributes:
        elongation, force: (n,) [m], [N].
        fitted, held: (n,) whether a row is fitted, and whether it is judged.
    """

    elongation: np.ndarray
    force: np.ndarray
    fitted: np.ndarray
    held: np.ndarray

    @property
    def scales(self) -> tuple[float, float]:
        """Largest magnitudes of elongation and force of the fitted rows; 0 where none is fitted."""
        elongation, force = (float(np.abs(v[self.fitted]).max(initial=0.0)) for v in (self.elongation, self.force))
        return elongation, force


def specimens(data: Path) -> list[Specimen]:
    """Every record of a folder that holds the data sets: campaigns of component tests first, then raw files.

    The order of the raw files alternates between the sets, so that a board that is stopped early has some of each.
    """
    folders = sorted(path.parent for path in data.glob("*/campaign.yaml"))
    campaigns = [Specimen(f, f.name) for f in folders if hx.read_campaign(f).protocol == "displacement"]
    sets = [
        [Specimen(file, place.split("/")[0], said) for file in sorted((data / place).glob("*.csv"))]
        for place, said in _SETS.items()
    ]
    # Files of a large set are spread over the whole list.
    shares = [((rank + 0.5) / len(files), one) for files in sets for rank, one in enumerate(files)]
    return campaigns + [one for _, one in sorted(shares, key=lambda share: share[0])]


def tests_of(campaign: hx.Campaign, question: str) -> list[Test]:
    """The tests of a campaign with what a question lets a method fit.

    Raises:
        UserError: a question leaves nothing to fit or nothing to judge.
    """
    found = [_ROWS[question](group) for group in _shared(campaign)]
    for what in ("fitted", "held"):
        if not any(getattr(test, what).any() for test in found):
            raise hx.UserError(f"{campaign.name}: '{question}' leaves no row that is {what}")
    return found


def _shared(campaign: hx.Campaign) -> list[list[hx.Experiment]]:
    """The completed experiments, those of one record together."""
    shared: list[list[hx.Experiment]] = []
    for experiment in campaign:
        if experiment.record is None or experiment.status != "completed":
            continue
        same = next((group for group in shared if group[0].record == experiment.record), None)
        if same is None:
            shared.append([experiment])
        else:
            same.append(experiment)
    return shared


def _last_rows(group: Sequence[hx.Experiment]) -> Test:
    """The rows within the windows of train and of test experiments."""
    thin = _thin(group[0])
    masks = {"train": np.zeros(len(thin), bool), "test": np.zeros(len(thin), bool)}
    for experiment in group:
        masks[experiment.split] |= replace(experiment, record=thin).in_window
    return Test(thin["elongation"], thin["force"], masks["train"], masks["test"] & ~masks["train"])


def _every_third_cycle(group: Sequence[hx.Experiment]) -> Test:
    """All rows but those of every third cycle."""
    record = group[0].record
    assert record is not None
    numbers = cycle_numbers(record["elongation"])
    thin = _thin(group[0])
    held = numbers[np.searchsorted(record.time, thin.time)] % 3 == 2
    return Test(thin["elongation"], thin["force"], ~held, held)


def _thin(experiment: hx.Experiment) -> hx.Record:
    whole = replace(experiment, window=None)
    assert whole.record is not None
    record = whole.record if len(whole.record) <= MOST_ROWS else thinned(whole, MOST_ROWS).record
    assert record is not None
    return record


_ROWS: dict[str, Callable[[Sequence[hx.Experiment]], Test]] = dict(
    zip(QUESTIONS, (_last_rows, _every_third_cycle), strict=True)
)


def windowed(campaign: hx.Campaign) -> hx.Campaign:
    """A campaign whose fitted experiments are the windows between the cycles that `every third cycle` leaves out.

    A window with fewer samples than the package takes is neither fitted nor judged.

    Raises:
        UserError: as `tests_of`.
    """
    parts: list[hx.Experiment] = []
    for group, test in zip(_shared(campaign), tests_of(campaign, QUESTIONS[1]), strict=True):
        record = _thin(group[0])
        if not campaign.has_time:  # its time is the number of a row
            record = replace(record, time=np.arange(float(len(record))))
        for rows in np.split(np.arange(len(record)), np.flatnonzero(np.diff(test.held)) + 1):
            if len(rows) < SAMPLES:
                continue
            begin, end = (float(record.time[row]) for row in rows[[0, -1]])
            name, split = f"{group[0].id}_{len(parts) + 1:03d}", "test" if test.held[rows[0]] else "train"
            parts.append(replace(group[0], id=name, record=record, window=(begin, end), split=split))
    return replace(campaign, experiments=tuple(parts))


def scales_of(tests: Sequence[Test]) -> tuple[float, float]:
    """Largest magnitudes of elongation [m] and force [N] of all fitted rows."""
    elongation, force = np.max([test.scales for test in tests], axis=0)
    return float(elongation), float(force)


def error(tests: Sequence[Test], forces: Sequence[np.ndarray], which: str) -> float:
    """RMS of the residual over the RMS of the measured force, of the rows that are `fitted` or `held`."""
    rows = [getattr(test, which) for test in tests]
    measured = np.concatenate([test.force[r] for test, r in zip(tests, rows, strict=True)])
    predicted = np.concatenate([force[r] for force, r in zip(forces, rows, strict=True)])
    return float(np.sqrt(np.mean((predicted - measured) ** 2) / np.mean(measured**2)))
