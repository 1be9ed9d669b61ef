"""The command line: `hsed` with its sub-commands, and `python -m hsed_jax.run`.  Parsing only."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from hsed_jax.errors import UserError
from hsed_jax.exit_status import ended
from hsed_jax.interruptions import Interrupted, ended_in_time

if TYPE_CHECKING:
    from hsed_jax.runs.ask_tell import AskTell
    from hsed_jax.runs.workflow import Run

_RUN = "Run the steps of a study; of files, make the campaign and its study first, as hsed init does."
# Steps without a design, by the command that takes them.
_PARTS = (
    ("compare", "calibrate and compare with the measurements, without a design", "calibrate compare"),
    ("diagnose", "find the physical effects that the model lacks", "calibrate compare diagnose"),
    (
        "improve",
        "add the missing effects (or those you choose) and show the error fall",
        "calibrate compare diagnose improve",
    ),
    (
        "discover",
        "learn an effect that is not in the catalogue: its place, its curve and its formula, as an effect of your own",
        "calibrate compare diagnose discover improve",
    ),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """The `hsed` command."""
    return ended(command_line, arguments)


def run_main(arguments: Sequence[str] | None = None) -> int:
    """`python -m hsed_jax.run`: the same as `hsed run`."""

    def parser() -> argparse.ArgumentParser:
        from hsed_jax.runs.beginning import ParserOfFiles

        made = ParserOfFiles(prog="python -m hsed_jax.run", description=_RUN)
        _add_run(made, takes_files=True)
        return made

    return ended(parser, arguments)


def command_line() -> argparse.ArgumentParser:
    """The parser of `hsed`."""
    from hsed_jax.app import command as app
    from hsed_jax.exports import command as exporting
    from hsed_jax.reporting import protocols
    from hsed_jax.runs import beginning
    from hsed_jax.sweeps import command as sweeping

    parser = beginning.ParserOfFiles(
        prog="hsed",
        description="Plan experiments, calibrate a structural model against them, find the physical effect it lacks.",
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    text = "run the steps of a study, or of the study that hsed init writes for files"
    _add_run(commands.add_parser("run", help=text, description=_RUN), takes_files=True)
    text = "validate a study and its data, or the files of a laboratory, and run nothing; of doubts it draws pictures"
    check = commands.add_parser("check", help=text, description=text.capitalize() + ".")
    check.add_argument("study", metavar="STUDY.yaml|FILE")
    check.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="override a key by its dotted path")
    check.add_argument("--trust", action="store_true", help="execute Python files that the study names, to check them")
    check.add_argument("--force", dest="force_column", metavar="COLUMN", help="of files: the column of the force")
    beginning.add_options(check)
    check.add_argument(
        "--predict",
        action="store_true",
        help="simulate 64 points of the priors, and print the data that the model cannot produce",
    )
    text = "earlier experiments: print their information about the planned experiments"
    check.add_argument("--worth", metavar="CAMPAIGN", help=text)
    check.set_defaults(command=_check)
    beginning.add_command(commands)
    for name, text, steps in _PARTS:
        part = commands.add_parser(name, help=text, description=text.capitalize() + ".")
        _add_run(part)
        part.set_defaults(steps=steps.split())
        if name == "improve":
            part.add_argument(
                "--add", action="append", metavar="EFFECT", help="add this effect; may be given several times"
            )
    _add_ask_and_tell(commands)
    sweeping.add_commands(commands)
    text = "write the report of a run again, or one page of several runs side by side"
    report = commands.add_parser("report", help=text, description=text.capitalize() + ".")
    report.add_argument("runs", nargs="+", metavar="RUN", help="run folder")
    report.add_argument(
        "--output", metavar="FILE.html", help="the file to write (default: RUN/report.html; of several runs: runs.html)"
    )
    report.set_defaults(command=_report)
    exporting.add_command(commands)
    text = "the catalogue of physical effects"
    effects = commands.add_parser("effects", help=text, description=text.capitalize() + ".")
    effects.add_argument("name", nargs="?", metavar="NAME", help="show one effect: equation, parameters, reference")
    effects.add_argument("--study", metavar="STUDY.yaml", help="include your own effects of this study")
    effects.add_argument("--trust", action="store_true", help="execute the Python files that the study names")
    effects.set_defaults(command=_effects)
    protocols.add_command(commands)
    app.add_command(commands)
    return parser


def _add_run(parser: argparse.ArgumentParser, takes_files: bool = False) -> None:
    from hsed_jax.runs import beginning

    parser.add_argument("study", metavar="STUDY.yaml|FILE" if takes_files else "STUDY.yaml")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="override a key by its dotted path")
    parser.add_argument("--output", metavar="DIR", help="run folder (default: runs/<study>)")
    existing = parser.add_mutually_exclusive_group()
    existing.add_argument("--resume", action="store_true", help="continue the run in the folder")
    if takes_files:
        beginning.add_force(existing, "replace the run in the folder")
        beginning.add_options(parser)
    else:
        existing.add_argument("--force", action="store_true", help="replace the run in the folder")
    parser.set_defaults(takes_files=takes_files)
    parser.add_argument("--check", action="store_true", help="validate, run nothing")
    parser.add_argument("--trust", action="store_true", help="with --check: execute Python files that the study names")
    parser.set_defaults(command=_run)


def _add_ask_and_tell(commands: Any) -> None:
    text = "ask for the next experiments of a design, or for the loading that a diagnosis proposes, to be performed by hand"
    ask = commands.add_parser("ask", help=text, description=text.capitalize() + ".")
    _add_design(ask)
    ask.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="override a key by its dotted path")
    which = ask.add_mutually_exclusive_group()
    out = "ask for N experiments at once (default: 1)"
    which.add_argument("--count", "--batch", type=int, default=1, metavar="N", help=out)
    which.add_argument("--again", metavar="ID", help="ask again for a failed experiment")
    ask.set_defaults(command=_ask)
    text = "report the measurements of an experiment, or its failure"
    tell = commands.add_parser("tell", help=text, description=text.capitalize() + ".")
    _add_design(tell)
    tell.add_argument(
        "id", nargs="?", metavar="ID", help="name of the experiment; one that was not requested needs its inputs"
    )
    tell.add_argument("--record", metavar="FILE", help="the record (default: the file in the folder of the request)")
    tell.add_argument(
        "--quantity", action="append", metavar="NAME=VALUE", help="in its declared unit; one option for each"
    )
    tell.add_argument(
        "--input", action="append", metavar="NAME=VALUE", help="the tested value, if it differs; one option for each"
    )
    ended = tell.add_mutually_exclusive_group()
    ended.add_argument("--failed", metavar="REASON", help="the experiment failed and may be requested again")
    ended.add_argument("--abandoned", metavar="REASON", help="the experiment is never requested again")
    ended.add_argument("--campaign", metavar="CAMPAIGN", help="add the experiments of an earlier campaign")
    tell.set_defaults(command=_tell_measured, overrides=[])


def _add_design(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("study", metavar="STUDY.yaml|RUN", help="a study, or its run folder")
    parser.add_argument("--output", metavar="DIR", help="run folder (default: runs/<study>)")


def _effects(options: Any) -> int:
    from hsed_jax.physics.effects import EFFECTS
    from hsed_jax.reporting.catalogue import catalogue, entry

    effects = EFFECTS
    if options.study:
        from hsed_jax.config.load import load_trusted
        from hsed_jax.study.own_parts import catalogue_of

        effects = catalogue_of(load_trusted(options.study, trust=options.trust))
    if not options.name:
        print(catalogue(effects))
        return 0
    # A picture of forms needs their priors, which the list does not load.
    from hsed_jax.analysis.form_curves import curves_of

    print(entry(options.name, effects, curves_of))
    return 0


def _check(options: Any) -> int:
    from hsed_jax.runs.beginning import check_files, files_of

    if files := files_of([options.study, *options.overrides]):
        check_files(files, options)
        return 0
    from hsed_jax.config.load import load_trusted

    study = load_trusted(options.study, options.overrides, trust=options.trust)
    # A wrong key is reported before the numerical packages are loaded.
    from hsed_jax.runs.checking import check_study

    predict, worth = getattr(options, "predict", False), getattr(options, "worth", None)
    check_study(study, Path(options.study), predict=predict, worth=worth)
    return 0


def _begin(options: Any) -> None:
    """Put the study of files in their place."""
    from hsed_jax.runs.beginning import files_of, study_of_files

    if files := files_of([options.study]) and files_of([options.study, *options.overrides]):
        options.overrides = [word for word in options.overrides if Path(word) not in files]
        options.study = str(study_of_files(files, options, None, resume=options.resume))


@ended_in_time()
def _run(options: Any) -> int:
    if getattr(options, "takes_files", False):
        _begin(options)
    if options.check:
        return _check(options)
    from hsed_jax.config.load import load_study

    steps = getattr(options, "steps", None)
    only = []
    if chosen := getattr(options, "add", None):
        steps = ["calibrate", "compare", "improve"]
        only.append(f"improve.add=[{', '.join(chosen)}]")
    if steps:
        only.append(f"steps=[{', '.join(steps)}]")
    study = load_study(options.study, [*options.overrides, *only])
    # A wrong key is reported before the numerical packages are loaded.
    from hsed_jax.runs.workflow import run

    output = Path(options.output) if options.output else Path("runs") / study.study
    try:
        done = run(study, output, resume=options.resume, force=options.force, tell=_tell)
    except Interrupted as stop:
        print(f"{stop}", file=sys.stderr)
        return 3
    if done.improvement is not None:
        improved = output / "improved.yaml"
        print(f"the improved study is {improved}; run it with: hsed run {quote(str(improved))}")
    for sentence in done.left_out:
        print(f"warning: {sentence}", file=sys.stderr)
    print(f"results in {output}; open {output / 'report.html'} in a browser")
    return 0


def _opened(options: Any) -> "AskTell":
    from hsed_jax.config.load import load_study
    from hsed_jax.runs.ask_tell import AskTell

    if Path(options.study).is_dir():
        if options.output or options.overrides:
            raise UserError(f"{options.study} is a run folder: its study is fixed; leave out --output and KEY=VALUE")
        return AskTell(output=options.study)
    return AskTell(load_study(options.study, options.overrides), options.output)


@ended_in_time()
def _ask(options: Any) -> int:
    from hsed_jax.runs.proposed_loading import ask_loading, has_no_design

    if has_no_design(options.study):
        print(ask_loading(options.study))
        return 0
    with _opened(options) as design:
        for asked in [design.ask_again(options.again)] if options.again else design.ask(options.count):
            print(design.told(asked))
        if design.stop_reason is not None and not design.conduct.pending:
            print(f"the design is complete: {design.stop_reason}; go on with: hsed run {quote(str(design.path / 'study.yaml'))} "
                  f"--output {quote(str(design.path))} --resume")  # fmt: skip
    return 0


def _tell_measured(options: Any) -> int:
    quantities, inputs = _numbers("--quantity", options.quantity), _numbers("--input", options.input)
    if (options.id is None) != (options.campaign is not None):
        raise UserError("give the ID of an experiment, or --campaign")
    with _opened(options) as design:
        if options.campaign is not None:
            from hsed_jax.measurements import read_campaign

            print(f"taken: {', '.join(design.take(read_campaign(options.campaign))) or 'nothing new'}")
        elif options.failed is not None:
            design.failed(options.id, options.failed, record=options.record, inputs=inputs)
        elif options.abandoned is not None:
            design.abandoned(options.id, options.abandoned, record=options.record, inputs=inputs)
        else:
            design.tell(options.id, record=options.record, quantities=quantities, inputs=inputs)
        print(design)
    return 0


def _numbers(option: str, given: Sequence[str] | None) -> dict[str, float] | None:
    """NAME=VALUE of a repeated option."""
    found = {}
    for word in given or ():
        name, _, value = word.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise UserError(f"{option} {word}: write NAME=VALUE with a number, such as V_P=2.1") from None
    return found or None


def _report(options: Any) -> int:
    from hsed_jax.left_out import LeftOut
    from hsed_jax.reporting.report import report_page
    from hsed_jax.reporting.side_by_side import comparison_page
    from hsed_jax.runs.folder import write_page
    from hsed_jax.runs.reading import holding, read_run

    folders = [Path(run) for run in options.runs]
    runs, left_out = [read_run(folder) for folder in folders], LeftOut()
    alone = len(runs) == 1
    output = Path(options.output) if options.output else folders[0] / "report.html" if alone else Path("runs.html")
    with holding(", ".join(options.runs)):
        page = report_page(runs[0], left_out) if alone else comparison_page(runs)
    write_page(page, output)
    for sentence in left_out.sentences:
        print(f"warning: {sentence}", file=sys.stderr)
    print(f"wrote {output}")
    return 0


def _tell(done: "Run", step: str) -> None:
    """The output for a user after a step; at once, also if the output goes into a file."""
    from hsed_jax.left_out import LeftOut

    left_out = LeftOut()
    for said in left_out.attempt(f"tables of the step {step}", lambda: [*map(str, _said(done, step))], []):
        print(f"\n{said}", flush=True)
    for sentence in left_out.sentences:
        print(f"warning: {sentence}", file=sys.stderr, flush=True)


def _said(done: "Run", step: str) -> Iterator[Any]:
    """The text for a step that has ended."""
    from hsed_jax.design.teaching import told
    from hsed_jax.measurements import check_campaign

    if step == "data" and (findings := check_campaign(done.campaign)):
        yield "\n".join(map(str, findings))
    elif step == "design" and done.steps:
        improvement = told([step["max_expected_improvement"] for step in done.steps])
        yield (
            f"{len(done.campaign)} experiments, max EI {max(improvement):.2e} at its largest and {improvement[-1]:.2e} "
            f"at the end; stopped by: {done.stop_reason}"
        )
        if done.drift is not None and (said := done.drift.sentence(done.built.mechanics.units)):
            yield said
    elif step == "calibrate":
        yield done.calibration
    elif step == "compare":
        yield from (done.comparison, done.location)
    elif step == "diagnose" and done.diagnosis is not None:
        yield done.diagnosis
        if done.diagnosis.effects:
            from hsed_jax.reporting.probabilities import EXPLAINED

            yield EXPLAINED
        if done.remaining is not None:
            yield f"with {' and '.join(map(done.diagnosis.called, done.diagnosis.effects))}: {done.remaining}"
    elif step == "discover" and done.discovery is not None:
        yield done.discovery
    elif step == "improve":
        yield done.trail
        if done.improvement is not None:
            yield f"the improved model, {done.improvement.calibration}"
            yield f"the improved model: {done.improvement.after}"
            yield f"the improved model: {done.improved_location}"
        if done.remainder is not None:
            yield done.remainder
