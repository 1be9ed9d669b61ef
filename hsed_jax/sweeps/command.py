"""The commands `hsed sweep`, `hsed sensitivity` and `hsed laws`: parsing and output only."""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hsed_jax.errors import UserError
from hsed_jax.interruptions import heed_interruptions

_GRID = ("values", "points", "ranges", "samples", "slurm")


def add_commands(commands: Any) -> None:
    """Add the commands to the sub-commands of `hsed`."""
    text = "run a study many times with some of its keys changed"
    sweep = commands.add_parser("sweep", help=text, description=text.capitalize() + ".")
    _add_study(sweep, "override a key in all studies by its dotted path")
    sweep.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=V1,V2,...",
        help="sweep a key over these values; may be given several times, and every combination is run",
    )
    sweep.add_argument(
        "--grid",
        metavar="SWEEP.yaml",
        help="a file with values, points, ranges, samples, slurm: what to sweep, and where",
    )
    sweep.add_argument("--samples", type=int, metavar="N", help="draw N points from the ranges, by Latin hypercube")
    sweep.add_argument(
        "--range",
        action="append",
        default=[],
        metavar="KEY=LOW,HIGH",
        help="a range that --samples draws from; or a distribution such as {loguniform: [0.01, 0.1]}",
    )
    sweep.add_argument("--output", metavar="DIR", help="folder of the sweep (default: runs/<study>_sweep)")
    existing = sweep.add_mutually_exclusive_group()
    existing.add_argument("--resume", action="store_true", help="run the studies in the folder that have not completed")
    existing.add_argument("--force", action="store_true", help="replace the sweep in the folder")
    sweep.add_argument(
        "--workers", type=int, metavar="N", help="processes of this machine (default: one for each core)"
    )
    sweep.add_argument("--scheduler", metavar="ADDRESS", help="run on the Dask cluster with this scheduler")
    sweep.add_argument("--check", action="store_true", help="validate every study, run nothing")
    sweep.set_defaults(command=_sweep)
    text = "Sobol' indices: which inputs and parameters the quantities depend on"
    sensitivity = commands.add_parser("sensitivity", help=text, description=text + ".")
    _add_study(sensitivity, "override a key by its dotted path")
    sensitivity.add_argument(
        "--samples", type=int, default=1024, metavar="N", help="a power of two (default: 1024); N (d + 2) simulations"
    )
    sensitivity.add_argument("--output", metavar="DIR", help="write indices.nc and the figure into this folder")
    sensitivity.set_defaults(command=_sensitivity)
    text = "calibrate materials of OpenSees on the tests of a study, and rank them by their held-out error"
    laws = commands.add_parser("laws", help=text, description=text.capitalize() + ".")
    _add_study(laws, "override a key by its dotted path")
    laws.add_argument("--materials", metavar="NAME,NAME,...", help="the materials (default: all of the table)")
    laws.add_argument("--output", metavar="DIR", help="folder of the runs (default: runs/<study>_laws)")
    existing = laws.add_mutually_exclusive_group()
    existing.add_argument("--resume", action="store_true", help="go on with the runs in the folder")
    existing.add_argument("--force", action="store_true", help="replace the runs in the folder")
    laws.set_defaults(command=_laws)


def _add_study(parser: argparse.ArgumentParser, help: str) -> None:
    parser.add_argument("study", metavar="STUDY.yaml")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help=help)


def _sweep(options: Any) -> int:
    heed_interruptions()
    from hsed_jax.config.load import load_study
    from hsed_jax.runs.workflow import Interrupted
    from hsed_jax.sweeps.plan import plan_of
    from hsed_jax.sweeps.sweep import sweep

    study = load_study(options.study, options.overrides)
    grid = _grid(options.grid) if options.grid else {}
    values = _merged("values", grid, _listed("--set", options.set))
    ranges = _merged("ranges", grid, {key: _range(given) for key, given in _listed("--range", options.range).items()})
    own = {override.partition("=")[0] for override in options.overrides}
    if clash := sorted(own & {*values, *ranges}):
        raise UserError(f"{clash[0]}: this key is both set for all studies and swept")
    samples = options.samples if options.samples is not None else grid.get("samples")
    if options.check:
        plan = plan_of(study, values, grid.get("points", ()), ranges, samples)
        plan.check()
        print(f"{options.study}: all {len(plan.points)} studies of the sweep over {', '.join(plan.keys)} are valid")
        return 0
    try:
        done = sweep(
            study,
            values,
            points=grid.get("points", ()),
            ranges=ranges,
            samples=samples,
            output=options.output,
            resume=options.resume,
            force=options.force,
            n_workers=options.workers,
            scheduler=options.scheduler,
            slurm=None if options.scheduler else grid.get("slurm"),
        )
    except Interrupted as stop:
        print(f"{stop}", file=sys.stderr)
        return 3
    print(done)
    if failed := done.count("failed"):
        listed = done.path / "failures.txt"
        print(f"{failed} of {len(done.table)} studies failed: {listed} has the reasons; --resume runs them again")
    print(f"results in {done.path}: table.parquet, results.nc, figures/comparison.png")
    return 0


def _sensitivity(options: Any) -> int:
    from hsed_jax.analysis.sensitivity import sensitivity
    from hsed_jax.config.load import load_study

    found = sensitivity(load_study(options.study, options.overrides), options.samples)
    print(found)
    if options.output:
        found.write(options.output)
        print(f"results in {options.output}: indices.nc, sensitivity.png")
    return 0


def _laws(options: Any) -> int:
    from hsed_jax.config.load import load_study
    from hsed_jax.config.opensees import asked_material

    study = load_study(options.study, options.overrides)
    names = tuple(filter(None, (word.strip() for word in (options.materials or "").split(","))))
    for name in names:
        asked_material(name, "--materials")
    # A wrong key is reported before the numerical packages are loaded.
    from hsed_jax.sweeps.laws import Law, laws

    def tell(law: Law) -> None:
        error = law.error_train if law.error_test is None else law.error_test
        print(f"{law.name}: {law.failed or f'error {error:.3f}'}", flush=True)

    print(laws(study, names, options.output, resume=options.resume, force=options.force, tell=tell))
    return 0


def _listed(option: str, given: list[str]) -> dict[str, list[Any]]:
    """`KEY=V1,V2` as lists by key; values as YAML has them."""
    from hsed_jax.config.load import parse_yaml

    found: dict[str, list[Any]] = {}
    for word in given:
        key, equals, text = word.partition("=")
        if not (key and equals and text):
            raise UserError(f"{option} {word}: give a key and its values, such as {option} error.relative=0.01,0.1")
        if key in found:
            raise UserError(f"{key}: this key is swept twice")
        found[key] = parse_yaml(f"[{text}]", f"{option} {word}")
    return found


def _range(given: list[Any]) -> Any:
    return given[0] if len(given) == 1 and isinstance(given[0], dict) else given


def _grid(path: str) -> dict[str, Any]:
    """A file with the points of a sweep, in the words of `hsed_jax.sweep`."""
    from hsed_jax.config.load import parse_yaml

    try:
        content = parse_yaml(Path(path).read_text(encoding="utf-8"), path)
    except (OSError, UnicodeDecodeError):
        raise UserError(f"{path}: there is no such file that can be read") from None
    if not isinstance(content, dict):
        raise UserError(f"{path}: a sweep is a mapping of {', '.join(_GRID)}")
    if unknown := [key for key in content if key not in _GRID]:
        raise UserError(f"{path}: {unknown[0]}: there is no such key; allowed here are {', '.join(_GRID)}")
    kinds = {"values": Mapping, "points": list, "ranges": Mapping, "samples": int, "slurm": Mapping}
    for key, value in content.items():
        if not isinstance(value, kinds[key]) or isinstance(value, bool):
            word = {Mapping: "a mapping of keys", list: "a list of mappings", int: "a whole number"}[kinds[key]]
            raise UserError(f"{path}: {key}: this must be {word}")
    for key, value in content.get("values", {}).items():
        if not isinstance(value, list):
            raise UserError(f"{path}: values.{key}: give a list of values to sweep over")
    for key, value in content.get("ranges", {}).items():
        if not isinstance(value, list | dict):
            raise UserError(f"{path}: ranges.{key}: give low and high, such as [0.01, 0.1], or a distribution")
    for point in content.get("points", []):
        if not isinstance(point, dict):
            raise UserError(
                f"{path}: points: a point is a mapping of keys to values, such as {{seed: 1}}, not {point!r}"
            )
    return content


def _merged(part: str, grid: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """The statements of the file and the command line together."""
    said = {str(key): value for key, value in grid.get(part, {}).items()}
    if twice := sorted(said.keys() & given):
        raise UserError(f"{twice[0]}: this key is swept twice")
    return said | given
