"""The command `hsed init`: a study for a campaign, or a campaign and its study for a laboratory's files."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from hsed_jax.errors import UserError
from hsed_jax.plain import is_file, is_folder, stem_of

if TYPE_CHECKING:
    from hsed_jax.intake.beginning import Begun, Said
    from hsed_jax.measurements import Campaign, Finding

_STUDIES = (".yaml", ".yml")


class ParserOfFiles(argparse.ArgumentParser):
    """A parser to which `--force` alone means to replace what is there, and `--force COLUMN` the column of the force."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, with a `--force` that stands before a study, a folder or a file put behind all of these."""
        words = list(sys.argv[1:] if args is None else args)
        takes_column = getattr(self._option_string_actions.get("--force"), "nargs", None) == "?"
        for k, word in enumerate(words[:-1]) if takes_column else ():
            following = words[k + 1]
            is_study = Path(following).suffix.lower() in _STUDIES
            if word == "--force" and (
                is_study or "=" in following or is_file(Path(following)) or is_folder(Path(following))
            ):
                return super().parse_known_args([*words[:k], *words[k + 1 :], "--force"], namespace)
        return super().parse_known_args(words, namespace)


class _Force(argparse.Action):
    """`--force` and `--force COLUMN`."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        setattr(namespace, *(("force", True) if values is None else ("force_column", values)))


def add_command(commands: Any) -> None:
    """Add the command to the sub-commands of `hsed`."""
    text = "write a ready study for a campaign of measurements, or for the files of a laboratory"
    init = commands.add_parser("init", help=text, description=text.capitalize() + ".")
    what = (
        "folder of a campaign or of a project of DesignSafe, or files of one specimen: csv, txt, dat, out, lvm, xlsx, tdms, mat, "
        "npz, parquet, h5"
    )
    init.add_argument("campaign", nargs="+", metavar="CAMPAIGN|FILE", help=what)
    where = (
        "of a campaign: the study (default: CAMPAIGN/study.yaml); of files or a project: the folder (default: beside the first "
        "file or the project)"
    )
    init.add_argument("--output", metavar="STUDY.yaml|DIR", help=where)
    add_force(init, "replace an existing study or folder")
    init.add_argument(
        "--masses", metavar="M1,M2,...", help="of a shaken frame: masses of its floors [kg], from the lowest up"
    )
    text = "height of a storey or specimen [m]: hsed check judges the drift ratio by it, and gravity acts on a shaken frame"
    init.add_argument("--height", type=float, metavar="H", help=text)
    add_options(init)
    init.set_defaults(command=_init)


def add_force(parser: Any, replace: str) -> None:
    """Add `--force`, and what it means with a column behind it."""
    text = f"{replace}; with COLUMN: of files, the column of the force"
    parser.add_argument("--force", nargs="?", action=_Force, metavar="COLUMN", default=False, help=text)
    parser.set_defaults(force_column=None)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that complete files."""
    column = (
        "of files: the column of the elongation; its position if the columns have no names; 'd1 - d0' subtracts columns"
    )
    parser.add_argument("--elongation", metavar="COLUMN", help=column)
    parser.add_argument("--time", metavar="COLUMN", help="of files: the column of the time")
    text = "of files: the column of another channel, such as ground_acceleration; one option for each"
    parser.add_argument("--channel", action="append", default=[], metavar="NAME=COLUMN", help=text)
    text = "of files: unit of a column or channel; one option for each"
    parser.add_argument("--unit", action="append", default=[], metavar="COLUMN=UNIT", help=text)
    parser.add_argument("--sheet", metavar="NAME", help="of a workbook: the sheet to read")
    text = "the model: opensees: and a material, such as opensees:Pinching4 (default: a spring law that fits)"
    parser.add_argument("--model", metavar="MODEL", help=text)
    text = "share of each record, its end, that is held out and never fitted (default: a third; 0 holds out nothing)"
    parser.add_argument("--split", type=float, metavar="FRACTION", help=text)
    text = "a number that marks a missing sample, such as -9999; none if such numbers were measured"
    parser.add_argument("--missing", action="append", metavar="NUMBER", help=text)
    text = "leave out samples inside a record that lack a channel"
    parser.add_argument("--drop-missing", action="store_true", help=text)


def files_of(words: Sequence[str]) -> list[Path]:
    """The files of measurements among the words of a command: neither a folder, a study nor KEY=VALUE."""
    return [Path(word) for word in words if not _is_other(word) and ("=" not in word or Path(word).exists())]


def _is_other(word: str) -> bool:
    """Whether a word is a study, a folder, or nothing that could be a file of measurements."""
    from hsed_jax.intake.opening import FORMATS

    path = Path(word)
    if path.suffix.lower() in _STUDIES or is_folder(path):
        return True
    return not is_file(path) and path.suffix.lower().lstrip(".") not in FORMATS


def check_files(files: Sequence[Path], options: Any) -> "Begun":
    """Read files, print the chosen columns and the doubts, and write nothing.

    Arguments:
        files: of one specimen.
        options: of the command line.

    Raises:
        UserError: the files are not sufficient, or the data have errors.
    """
    from hsed_jax.intake.beginning import begun
    from hsed_jax.reporting.loops import sketch

    made = begun(files, _said(options))
    for line in (*made.taken, *(f"note: {note}" for note in made.notes)):
        print(line)
    _tell_findings(made.campaign, ", ".join(map(str, files[:3])), made.doubts)
    if sys.stdout.isatty():
        print(sketch(made.campaign))
    return made


def study_of_files(files: Sequence[Path], options: Any, output: str | None, *, resume: bool = False) -> Path:
    """Make the campaign and the study of files, and print the chosen columns.

    Arguments:
        files: of one specimen.
        options: of the command line.
        output: the folder; by default one beside the first file, called like it.
        resume: whether a study that is there is the one.

    Returns:
        The study.

    Raises:
        UserError: the files are not sufficient, the data have errors, or the folder exists.
    """
    folder = Path(output) if output else _beside(files[0])
    study = folder / "study.yaml"
    if resume and study.exists():
        return study
    if study.exists() and not options.force:
        raise UserError(
            f"{folder} exists already; run its study with: hsed run {quote(str(study))}; or say --force to replace it, or choose "
            "another --output of hsed init"
        )
    from hsed_jax.drafting.initial import text_of_study
    from hsed_jax.measurements import check_campaign, read_campaign, write_campaign
    from hsed_jax.reporting.doubt_figures import write_pictures
    from hsed_jax.reporting.loops import loops_picture

    made = check_files(files, options)
    try:
        write_campaign(made.campaign, folder)
        campaign = read_campaign(folder)
        names = ", ".join(file.name for file in files[:3]) + (" ..." if len(files) > 3 else "")
        taken = [f"Made of {names}:", *(f"  {line}" for line in (*made.taken, *made.notes))]
        _write_study(study, text_of_study(campaign, folder, study, _frame(options), taken, _model(options, campaign)))
        if (picture := loops_picture(campaign)) is not None:
            _write(folder / "loops.png", picture)
        findings = [*check_campaign(campaign), *made.doubts]
        for id, path in write_pictures(campaign, findings, folder / "figures"):
            print(f"{id}: the picture {path} marks the doubtful samples")
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror}); choose another --output") from None
    return study


def _beside(file: Path) -> Path:
    folder = file.with_name(stem_of(file.name))
    return folder.with_name(f"{folder.name}_campaign") if folder.is_file() else folder


def _init(options: Any) -> int:
    from hsed_jax.runs.projects import is_project

    files = files_of(options.campaign)
    if files:
        if len(files) < len(options.campaign):
            raise UserError("give either one folder of a campaign, or files of one specimen")
        study = study_of_files(files, options, options.output)
    elif len(options.campaign) > 1:
        raise UserError("give one folder of a campaign; files of one specimen may be several")
    elif is_project(folder := Path(options.campaign[0])):
        study = _study_of_project(folder, options)
    else:
        study = _study_of_campaign(folder, options)
    print(f"wrote {study}; run it with: hsed run {quote(str(study))}")
    return 0


def _study_of_campaign(folder: Path, options: Any) -> Path:
    from hsed_jax.drafting.initial import text_of_study
    from hsed_jax.measurements import read_campaign

    if said := [flag for flag in ("elongation", "force_column", "time", "channel", "unit", "sheet", "split", "missing")
                if getattr(options, flag)]:  # fmt: skip
        flag = said[0].removesuffix("_column")
        raise UserError(
            f"--{flag} is an option for files; {folder} is a campaign, whose campaign.yaml and experiments.csv give it"
        )
    campaign = read_campaign(folder)
    _tell_findings(campaign, str(folder))
    output = Path(options.output) if options.output else folder / "study.yaml"
    if output.exists() and not options.force:
        raise UserError(f"{output} exists already; say --force to replace it or choose another --output")
    _write_study(output, text_of_study(campaign, folder, output, _frame(options), model=_model(options, campaign)))
    return output


def _study_of_project(folder: Path, options: Any) -> Path:
    """The campaign of a project as a separate folder, with the study of the project, or with a new one."""
    from hsed_jax.runs.projects import read_designsafe, unpack

    output = Path(options.output) if options.output else folder.with_name(f"{folder.resolve().name}_campaign")
    study = output / "study.yaml"
    if study.exists() and not options.force:
        raise UserError(f"{output} exists already; say --force to replace it or choose another --output")
    project = read_designsafe(folder)
    try:
        unpacked = unpack(project, output)
    except OSError as error:
        raise UserError(f"{output}: cannot be written ({error.strerror}); choose another --output") from None
    if unpacked is not None:
        _tell_findings(project.campaign, str(folder))
        return unpacked
    return _study_of_campaign(output, argparse.Namespace(**{**vars(options), "output": None}))


def _tell_findings(campaign: "Campaign", where: str, doubts: "Sequence[Finding]" = ()) -> None:
    """Print the findings of the checks, and further doubts.

    Raises:
        UserError: an error is among them.
    """
    from hsed_jax.measurements import check_campaign

    findings = check_campaign(campaign)
    for finding in (*findings, *doubts):
        print(finding)
    if any(finding.level == "error" for finding in findings):
        raise UserError(f"{where}: the data have errors, listed above; nothing is repaired silently")


def _write_study(path: Path, text: str) -> None:
    try:
        _write(path, text)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another --output") from None


def _write(path: Path, content: str | bytes) -> None:
    from hsed_jax.drafts import write_whole

    write_whole(path, content)


def _frame(options: Any) -> Any:
    """The user's statements on a frame."""
    from hsed_jax.drafting.initial import Frame

    masses = getattr(options, "masses", None)
    try:
        numbers = tuple(float(word) for word in masses.split(",")) if masses else ()
    except ValueError:
        raise UserError(f"--masses {masses}: write numbers in kg, such as 22118,18810") from None
    return Frame(numbers, getattr(options, "height", None) or 0.0)


def _model(options: Any, campaign: "Campaign") -> list[str]:
    """The lines of the requested model; empty for a spring law."""
    if options.model is None:
        return []
    from hsed_jax.study.first_material import material_lines

    return material_lines(options.model, campaign)


def _said(options: Any) -> "Said":
    """The statements of the flags on the files."""
    from hsed_jax.intake.beginning import Said
    from hsed_jax.intake.choice import HELD_OUT

    given = {"elongation": options.elongation, "force": options.force_column, "time": options.time}
    columns = {channel: column for channel, column in given.items() if column} | _pairs("--channel", options.channel)
    held_out = HELD_OUT if options.split is None else options.split
    if not 0 <= held_out < 1:
        raise UserError(f"--split {held_out:g}: write the share of the record that is held out, from 0 to less than 1")
    return Said(
        columns=columns,
        units=_pairs("--unit", options.unit),
        sheet=options.sheet,
        held_out=held_out,
        missing=_missing(options.missing),
        drops_missing=options.drop_missing,
    )


def _pairs(option: str, words: Sequence[str]) -> dict[str, str]:
    found = {}
    for word in words:
        name, _, value = word.rpartition("=") if option == "--unit" else word.partition("=")
        if not name or not value:
            raise UserError(f"{option} {word}: write {'COLUMN=UNIT' if option == '--unit' else 'NAME=COLUMN'}")
        found[name] = value
    return found


def _missing(words: Sequence[str] | None) -> tuple[float, ...] | None:
    if words is None:
        return None
    try:
        return tuple(float(word) for word in words if word.lower() != "none")
    except ValueError:
        raise UserError(f"--missing {' '.join(words)}: write a number such as -9999, or none") from None
