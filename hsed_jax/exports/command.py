"""`hsed export`: the results of a run, for other programs and for a paper."""

from pathlib import Path
from typing import Any

from hsed_jax.errors import UserError


def add_command(commands: Any) -> None:
    """Add `export` to the command line."""
    text = "write the calibrated law of a run as scripts for OpenSees, or its parameters as a table for a paper"
    export = commands.add_parser("export", help=text, description=text.capitalize() + ".")
    export.add_argument("run", metavar="RUN", help="run folder; after an improvement the improved model is exported")
    export.add_argument("--opensees", action="store_true", help="specimen.py and specimen.tcl: the law at its MAP")
    export.add_argument(
        "--table", action="store_true", help="parameters.md and parameters.tex: means, 90 %% intervals, priors"
    )
    export.add_argument("--before", action="store_true", help="export the model before its improvement")
    export.add_argument("--out", metavar="DIR", help="where to (default: RUN/export)")
    export.set_defaults(command=_export)


def _export(options: Any) -> int:
    from hsed_jax.exports.export import KINDS, export

    kinds = [kind for kind in KINDS if getattr(options, kind)]
    if not kinds:
        raise UserError("choose what to export: --opensees, --table or both")
    for kind in kinds:
        written = export(options.run, options.out, kind=kind, before=options.before)
        for path in written:
            print(f"wrote {path}")
        if options.out is None and any(path.name == "check.json" for path in written):
            print(f"wrote {_reported(Path(options.run))}")
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
