"""`hx.export` and `hsed export`: files for other programs and for papers."""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.exports.calibrated import Calibrated, calibrated
from hsed_jax.exports.counterparts import material
from hsed_jax.exports.materials import check_text, command_of, difference, test_of, version
from hsed_jax.exports.programs import entries
from hsed_jax.exports.programs import markdown as tables
from hsed_jax.exports.scripts import python_script, tcl_script
from hsed_jax.exports.table import latex, markdown, rows
from hsed_jax.runs.reading import holding
from hsed_jax.study.opensees_study import OpenSeesMechanics

if TYPE_CHECKING:
    from hsed_jax.analysis.calibration import Calibration
    from hsed_jax.analysis.remedy import Improvement

KINDS = ("opensees", "table", "programs")


def export(
    source: "str | Path | Calibration | Improvement",
    output: str | Path | None = None,
    *,
    kind: str = "opensees",
    before: bool = False,
) -> list[Path]:
    r"""Write a calibrated law as scripts for OpenSees, or its parameters as a table for a paper.

    The scripts have the law at θ_MAP: the values of one point belong together. The means of correlated parameters may not fit
    the data if the law is nonlinear in them.  The table has means and 90 % intervals.

    Arguments:
        source: a run folder, whose improved model is exported if it exists, or the object that `hx.calibrate` or `hx.improve`
            returns.
        output: folder to write into; by default `export` in the run folder, else in the working directory.
        kind: `opensees` writes `specimen.py` (OpenSeesPy) and `specimen.tcl` (of several specimens two files each, by their
            names; of a material of OpenSees also `protocol.csv`, the test along which the script was run, and `check.json`,
            its difference from the simulation and the version of OpenSees), `table` writes `parameters.md` and
            `parameters.tex`, `programs` writes `programs.md`: the law as input of SAP2000, SeismoStruct and Abaqus, if they
            have an equal law.
        before: export the first model instead of the improved one.

    Returns:
        The files written; elongations in m and forces in N, rotations and moments, strains and stresses likewise in SI.

    Raises:
        UserError: there is no calibration, the law or an effect has no counterpart in OpenSees, the model is the user's code,
            or the folder cannot be written to.

    Example:
        >>> [file.name for file in hx.export("runs/wall")]
        ['specimen.py', 'specimen.tcl']
    """
    if kind not in KINDS:
        raise UserError(f"kind: this must be one of {', '.join(KINDS)}, but it is {kind!r}")
    with holding(source) if isinstance(source, str | Path) else nullcontext():
        files = _files(calibrated(source, before=before), kind)
    folder = (
        Path(output)
        if output is not None
        else Path(source) / "export"
        if isinstance(source, str | Path)
        else Path("export")
    )
    if output is None and folder.is_symlink():
        raise UserError(f"{folder} is a symbolic link, and the files would go elsewhere; give a folder (--out)")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            write_whole(folder / name, text)
    except OSError as error:
        raise UserError(f"{folder} cannot be written to ({error.strerror}); choose another folder (--out)") from None
    return [folder / name for name in files]


def _files(model: Calibrated, kind: str) -> dict[str, str]:
    if kind == "opensees":
        return _material(model) if isinstance(model.built.mechanics, OpenSeesMechanics) else _scripts(model)
    if kind == "programs":
        return _programs(model)
    table = rows(model)
    return {"parameters.md": markdown(table), "parameters.tex": latex(table)}


def _material(model: Calibrated) -> dict[str, str]:
    """The scripts of a material of OpenSees, the test of their check, and the result of the check."""
    command, test, opensees, reach = command_of(model), test_of(model), version(), model.reach()
    title = (
        f"The calibrated {command.words[0]} of the study {' '.join(model.name.split())}, for OpenSees; in N, m and s."
    )
    notes = [
        f"Its parameters are those at the maximum of the posterior.  It assumes the semantics of OpenSees {opensees}."
    ]
    script = python_script(title, notes, [command], reach)
    share = difference(script, test)
    notes.append(
        f"Along protocol.csv its force differs from the simulation by {share:.2g} (RMS over standard deviation)."
    )
    return {
        "specimen.py": python_script(title, notes, [command], reach),
        "specimen.tcl": tcl_script(title, notes, [command], reach),
        "protocol.csv": test.csv,
        "check.json": check_text(share, opensees),
    }


def _programs(model: Calibrated) -> dict[str, str]:
    """The numbers of each specimen for other programs."""
    if isinstance(model.built.mechanics, OpenSeesMechanics):
        raise UserError("a material of OpenSees is equal to no law of SAP2000, SeismoStruct and Abaqus")
    files = {}
    for element in model.built.mechanics.elements:
        law, effects, _ = model.of(element)
        name = "programs" if not element.name else f"programs_{element.name}"
        title = f"The calibrated law of {element.name or 'the specimen'} of the study {' '.join(model.name.split())}"
        files[f"{name}.md"] = tables(
            title, entries(law, effects, model.scales, model.reach(), model.built.mechanics.pair)
        )
    return files


def _scripts(model: Calibrated) -> dict[str, str]:
    files = {}
    for element in model.built.mechanics.elements:
        law, effects, outside = model.of(element)
        reach = model.reach()
        commands = material(law, effects, model.scales, reach)
        name = element.name or "specimen"
        title = (
            f"The calibrated law of {name} of the study {' '.join(model.name.split())}, for OpenSees; in N, m and s."
        )
        notes = [f"{law.name} at the maximum of the posterior{', with ' + ', '.join(effects) if effects else ''}."]
        if outside:
            notes.append(f"Not included, because they belong to the structure or the test rig: {', '.join(outside)}.")
        if any(command.words[0] == "Viscous" for command in commands):
            notes.append("Rate-dependent parts (Viscous) act only in a transient analysis; the loop below is static.")
        if any(command.words[0] == "ElasticMultiLinear" for command in commands):
            notes.append(f"Curves are tabulated up to {2 * reach:.3g} m.")
        files[f"{name}.py"] = python_script(title, notes, commands, reach)
        files[f"{name}.tcl"] = tcl_script(title, notes, commands, reach)
    return files
