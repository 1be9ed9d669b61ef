"""`hsed export`: the results of a run, for other programs, for a paper and for a repository of data."""

from pathlib import Path
from typing import Any

from hsed_jax.errors import UserError


def add_command(commands: Any) -> None:
    """Add `export` to the command line."""
    text = (
        "write the calibrated law of a run as scripts for OpenSees, its parameters as a table for a paper, or a run or a "
        "campaign as a project of DesignSafe"
    )
    export = commands.add_parser("export", help=text, description=text.capitalize() + ".")
    what = "run folder; after an improvement the improved model is exported; for --designsafe also the folder of a campaign"
    export.add_argument("run", metavar="RUN|CAMPAIGN", help=what)
    export.add_argument("--opensees", action="store_true", help="specimen.py and specimen.tcl: the law at its MAP")
    export.add_argument(
        "--table", action="store_true", help="parameters.md and parameters.tex: means, 90 %% intervals, priors"
    )
    text = (
        "a project of DesignSafe in a new folder: model, sensor list, events, analysis and report, with their metadata"
    )
    programs = "programs.md: the law at its MAP for SAP2000, SeismoStruct and Abaqus, where their law is equal"
    export.add_argument("--programs", action="store_true", help=programs)
    export.add_argument("--designsafe", metavar="FOLDER", help=text)
    export.add_argument("--hybrid", action="store_true", help="the project of DesignSafe is a hybrid simulation")
    export.add_argument("--before", action="store_true", help="export the model before its improvement")
    export.add_argument("--out", metavar="DIR", help="where to (default: RUN/export)")
    export.set_defaults(command=_export)


def _export(options: Any) -> int:
    from hsed_jax.exports.export import KINDS, export

    kinds = [kind for kind in KINDS if getattr(options, kind)]
    if not kinds and options.designsafe is None:
        raise UserError("choose what to export: --opensees, --table, --programs or --designsafe FOLDER")
    if options.hybrid and options.designsafe is None:
        raise UserError("--hybrid is the type of a project of DesignSafe; say --designsafe FOLDER, too")
    for kind in kinds:
        written = export(options.run, options.out, kind=kind, before=options.before)
        for path in written:
            print(f"wrote {path}")
        if options.out is None and any(path.name == "check.json" for path in written):
            print(f"wrote {_reported(Path(options.run))}")
    if options.designsafe is not None:
        from hsed_jax.exports.designsafe import write_designsafe

        written = write_designsafe(options.run, options.designsafe, hybrid=options.hybrid)
        print(f"wrote {len(written)} files into {options.designsafe}; their categories are in {written[-1]}")
    return 0


def _reported(run: Path) -> Path:
    """Write the report of a run again, with the check of its exported script."""
    from hsed_jax.reporting.report import report_page
    from hsed_jax.runs.folder import write_page
    from hsed_jax.runs.reading import holding, read_run

    with holding(run):
        page = report_page(read_run(run))
    write_page(page, run / "report.html")
    return run / "report.html"
