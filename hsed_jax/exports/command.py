"""`hsed export`: the results of a run, for other programs and for a paper."""

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
        for path in export(options.run, options.out, kind=kind, before=options.before):
            print(f"wrote {path}")
    return 0
