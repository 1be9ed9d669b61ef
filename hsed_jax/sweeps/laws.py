"""Several laws calibrated on the same tests, and ranked by their predictions of held-out data."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hsed_jax.config.load import load_study
from hsed_jax.config.opensees import asked_material
from hsed_jax.config.schema import Study
from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.models.opensees import MATERIALS
from hsed_jax.runs.workflow import run
from hsed_jax.study.first_material import PREFIX
from hsed_jax.tables import Table, Tabular, cell

FILE = "laws.json"


@dataclass(frozen=True)
class Law:
    """A law and its errors.

    Attributes:
        name: `opensees:` and a material, or the spring law, function or program of the study.
        error_train, error_test: normalised RMS errors of the fitted and of the held-out data; None without such data.
        coverage: share of the held-out samples within the 90 % band.
        free: number of calibrated parameters.
        failed: the reason for a missing result; None with a result.
    """

    name: str
    error_train: float | None = None
    error_test: float | None = None
    coverage: float | None = None
    free: int | None = None
    failed: str | None = None

    @property
    def rank(self) -> tuple[float, float]:
        """Smaller is better: the held-out error, then the other."""
        return tuple(math.inf if e is None else e for e in (self.error_test, self.error_train))  # pyright: ignore[reportReturnType]


@dataclass(frozen=True, repr=False)
class Laws(Tabular):
    """Laws calibrated on the same tests, in the order of their predictions.

    Attributes:
        study: name of the study.
        laws: in the order of their held-out errors; those that failed last.
        noise_floor: the held-out error of the noise alone, for the best law.
    """

    study: str
    laws: tuple[Law, ...]
    noise_floor: float | None

    @property
    def best(self) -> Law | None:
        """The law with the smallest held-out error; None without held-out data, or if all failed."""
        return self.laws[0] if self.laws and self.laws[0].error_test is not None else None

    def _table(self) -> Table:
        rows = [
            (law.name, str(law.free or "–"), *map(cell, (law.error_train, law.error_test, law.coverage)))
            for law in self.laws
        ]
        notes = [f"{law.name} failed: {law.failed}" for law in self.laws if law.failed is not None]
        if self.noise_floor is not None:
            notes.append(f"the noise alone would leave {self.noise_floor:.3f} of what was held out")
        told = "nothing was held out, so no law is ranked by its prediction; give experiments of the split test"
        if (best := self.best) is not None:
            told = f"{best.name} predicts the held-out data best: its error is {best.error_test:.3f}"
        heads = ("law", "free", "error train", "error test", "coverage of 90 %")
        return Table(f"{self.study}: {told}", heads, rows, notes)

    def written(self) -> str:
        """The text of `laws.json`."""
        content = {"study": self.study, "noise_floor": self.noise_floor, "laws": [vars(law) for law in self.laws]}
        return json.dumps(content, indent=2) + "\n"


def laws(
    study: Study,
    materials: Sequence[str] = (),
    output: str | Path | None = None,
    *,
    resume: bool = False,
    force: bool = False,
    tell: Callable[[Law], None] | None = None,
) -> Laws:
    """Calibrate the model of a study and materials of OpenSees on its campaign, and rank them by the held-out error.

    Arguments:
        study: of a test whose elongation was imposed.
        materials: of OpenSees; by default all of the table.
        output: folder of the runs, one each; by default `runs/<study>_laws`.
        resume: continue the existing runs.
        force: replace them.
        tell: called with each law at its end.

    Returns:
        The laws in order. A law whose run fails is among them with the reason.

    Raises:
        UserError: the study has no campaign, a material is unknown, the folder has laws already, or every law failed.

    Example:
        ```python
        found = hx.laws(hx.load_study("column/study.yaml"), ["Pinching4", "IMKPinching"])
        found.best.name  # the law that predicts best what was not fitted
        ```

        A mistake is reported before the calibrations:

        >>> study = hx.initial_study(hx.read_files("wall.csv"), "wall.yaml")
        >>> hx.laws(study, ["Pinchign4"])  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        hsed_jax.errors.UserError: ...did you mean Pinching4?...
    """
    if study.experiments.campaign is None:
        raise UserError("experiments.campaign: laws are compared on measured tests; give a campaign")
    for name in materials:
        asked_material(name, "materials")
    folder = Path(output) if output is not None else Path("runs") / f"{study.study}_laws"
    if (folder / FILE).exists() and not (resume or force):
        raise UserError(
            f"{folder} has laws already; say --resume to go on with them, --force to replace them, or choose --output"
        )
    kind, own = study.model.described
    models: dict[str, Any] = {f"{PREFIX}{own}" if kind == "opensees" else own: None}
    models |= {
        f"{PREFIX}{name}": {"opensees": name} for name in materials or MATERIALS if f"{PREFIX}{name}" not in models
    }
    found, floors = [], {}
    for name, model in models.items():
        law, floors[name] = _law(study, name, model, folder, resume, force)
        found.append(law)
        if tell is not None:
            tell(law)
    if all(law.failed is not None for law in found):
        raise UserError(f"no law could be calibrated; {found[0].name}: {found[0].failed}")
    ranked = sorted(found, key=lambda law: law.rank)
    done = Laws(study.study, tuple(ranked), floors[ranked[0].name])
    write_whole(folder / FILE, done.written())
    return done


def _law(
    study: Study, name: str, model: dict[str, Any] | None, folder: Path, resume: bool, force: bool
) -> tuple[Law, float | None]:
    """One law, calibrated and compared in a separate run folder, and the noise floor of the held-out data."""
    content = study.written()
    content["steps"], content["study"] = ["calibrate", "compare"], name.replace(":", "_")
    if model is not None:
        content["model"] = model
    content["experiments"] = {"campaign": str((study.folder / str(study.experiments.campaign)).resolve())}
    place = folder / content["study"]
    try:
        done = run(
            load_study(content), place, resume=resume and place.exists(), force=force, progress=False, figures=False
        )
    except UserError as error:
        return Law(name, failed=str(error)), None
    assert done.calibration is not None and done.comparison is not None
    free, comparison = len(done.calibration.fit.posterior.model_names), done.comparison
    test = comparison.test
    if test is None:
        return Law(name, comparison.train.error, free=free), None
    covered = [values["coverage_90"] for values in test.per_output.values() if "coverage_90" in values]
    coverage = sum(covered) / len(covered) if covered else None
    return Law(name, comparison.train.error, test.error, coverage, free), test.noise_floor
