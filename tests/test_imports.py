"""Imports go downwards only, nothing private of JAX is used, and no module grows beyond 400 lines."""

import ast
import re
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pytest
from builders.places import ROOT, TESTS

PACKAGE = ROOT / "hsed_jax"
LEVELS = (
    ("drafts", "errors", "backend", "interruptions", "tables"),
    ("exit_status", "left_out", "memory", "plain", "programs"),
    ("python_files", "registry"),
    ("physics",),
    ("sections",),
    ("measurements",),
    ("behaviour",),
    ("intake", "drafting"),
    ("laboratories",),
    ("models",),
    ("inference",),
    ("design",),
    ("criticism",),
    ("config",),
    ("study",),
    ("diagnosis",),
    ("discovery",),
    ("reporting",),
    ("analysis",),
    ("runs",),
    ("exports",),
    ("plot",),
    ("sweeps",),
    ("app",),
    ("command_line",),
    ("run", "__main__"),
)
LEVEL = {room: level for level, rooms in enumerate(LEVELS) for room in rooms}
MODULES = sorted(PACKAGE.rglob("*.py"))


def imported(source: str, module: tuple[str, ...], is_package: bool = False) -> Iterator[tuple[int, str]]:
    """(line, dotted name) of everything a module imports, wherever the import stands; relative ones resolved."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = node.level - is_package
            base = module[: len(module) - above] if node.level else ()
            stem = ".".join((*base, *([node.module] if node.module else [])))
            yield from ((node.lineno, f"{stem}.{alias.name}") for alias in node.names)


def upward_imports(source: str, module: tuple[str, ...], is_package: bool = False) -> list[str]:
    """What a module imports that does not lie below it (or in its own room)."""
    faults = []
    if module[1:] == ():
        return faults  # hsed_jax/__init__.py gathers the public names
    own = LEVEL.get(module[1])
    if own is None:
        return [f"room {module[1]!r} has no level"]
    for line, name in imported(source, module, is_package):
        parts = name.split(".")
        if parts[0] != "hsed_jax" or len(parts) == 1:
            continue
        other = LEVEL.get(parts[1])
        if other is None:
            faults.append(f"line {line}: {name} is imported from the top of the package")
        elif other > own or (other == own and parts[1] != module[1]):
            faults.append(f"line {line}: {module[1]} imports {name}")
    return faults


def modules_imported(source: str, module: tuple[str, ...], is_package: bool, known: Collection[str]) -> set[str]:
    """The modules of the package that a module imports, wherever the import stands: in a function or for type checking, too."""
    found = set()
    for _, name in imported(source, module, is_package):
        while name and name not in known:
            name = name.rpartition(".")[0]
        found.add(name)
    # The package itself gathers public names, and who imports it by its name alone needs none of them at once.
    return found - {"", "hsed_jax", ".".join(module)}


def circles(graph: Mapping[str, Collection[str]]) -> list[set[str]]:
    """Sets of modules that reach one another along imports."""
    reached = {}
    for start in graph:
        seen, todo = set(), [start]
        while todo:
            fresh = set(graph[todo.pop()]) - seen
            seen |= fresh
            todo += fresh
        reached[start] = seen
    found = []
    for module, seen in reached.items():
        if module in seen and not any(module in one for one in found):
            found.append({other for other in seen if module in reached[other]})
    return found


def private_imports(source: str) -> list[str]:
    """Names below `jax._src` that a module imports or reaches by attributes."""
    faults = [f"line {line}: {name}" for line, name in imported(source, ("m",)) if name.startswith("jax._src")]
    nodes = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Attribute))
    return faults + [f"line {node.lineno}: ._src" for node in nodes if node.attr == "_src"]


def dotted(path: Path) -> tuple[str, ...]:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module_imports_downwards_only_and_nothing_private_and_is_short(path):
    source = path.read_text(encoding="utf-8")
    assert upward_imports(source, dotted(path), path.name == "__init__.py") == []
    assert private_imports(source) == []
    assert len(source.splitlines()) <= 400


def test_no_modules_import_one_another_in_a_circle():
    names = {".".join(dotted(path)): path for path in MODULES}
    graph = {
        name: modules_imported(path.read_text(encoding="utf-8"), dotted(path), path.name == "__init__.py", names)
        for name, path in names.items()
    }
    assert circles(graph) == []


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        ({"a": "b", "b": "c", "c": ""}, []),
        ({"a": "b", "b": "a", "c": "a"}, [{"a", "b"}]),
        ({"a": "b", "b": "cd", "c": "a", "d": "e", "e": "d"}, [{"a", "b", "c"}, {"d", "e"}]),
    ],
)
def test_the_checker_finds_circles(graph, expected):
    assert circles(graph) == expected


def test_the_checker_sees_imports_in_functions_and_for_type_checking():
    source = "from x.b import B\ndef f():\n    from x import c\nif TYPE_CHECKING:\n    import x.d\nfrom x.c import C"
    assert modules_imported(source, ("x", "a"), False, {"x", "x.a", "x.b", "x.c", "x.d"}) >= {"x.b", "x.c", "x.d"}


BEYOND_REPORTING = (
    "jax",
    "numpyro",
    "scipy",
    "hsed_jax.inference",
    "hsed_jax.design",
    "hsed_jax.laboratories",
    "hsed_jax.physics.simulator",
)
# Results that are drawn, and names that are told.
ALLOWED = {"hsed_jax.inference.fit.Fit", "hsed_jax.laboratories.kinds.KINDS"}


@pytest.mark.parametrize(
    "path", [path for path in MODULES if path.parent.name == "reporting"], ids=lambda path: path.name
)
def test_reporting_draws_and_computes_nothing(path):
    names = {name for _, name in imported(path.read_text(encoding="utf-8"), dotted(path)) if name not in ALLOWED}
    assert [name for name in names if any(f"{name}.".startswith(f"{room}.") for room in BEYOND_REPORTING)] == []


@pytest.mark.parametrize(
    ("source", "module"),
    [
        ("from hsed_jax.inference.nuts import advance", ("hsed_jax", "physics", "integrate")),
        ("def f():\n    import hsed_jax.design.kriging", ("hsed_jax", "inference", "nuts")),
        ("if True:\n    from hsed_jax import config", ("hsed_jax", "physics", "outputs")),
        ("from ..criticism import locate", ("hsed_jax", "design", "space")),
        ("from hsed_jax import backend as b", ("hsed_jax", "errors")),  # beside, not below
        ("from hsed_jax.command_line import main", ("hsed_jax", "runs", "folder")),
        ("from hsed_jax import simulate", ("hsed_jax", "runs", "workflow")),
        ("import numpy", ("hsed_jax", "newroom", "x")),
    ],
)
def test_the_checker_catches_an_import_that_is_not_downwards(source, module):
    assert upward_imports(source, module)


@pytest.mark.parametrize(
    ("source", "module"),
    [
        ("import hsed_jax\nimport numpy.linalg\nfrom jax import numpy", ("hsed_jax", "physics", "integrate")),
        ("from hsed_jax.physics.outputs import output", ("hsed_jax", "physics", "integrate")),
        ("from .outputs import output\nfrom ..errors import UserError", ("hsed_jax", "physics", "integrate")),
        ("from hsed_jax.errors import UserError\nfrom hsed_jax import errors", ("hsed_jax", "measurements", "units")),
        ("from hsed_jax import sweeps", ("hsed_jax", "run")),
        ("from hsed_jax.command_line import main", ("hsed_jax",)),
    ],
)
def test_the_checker_passes_what_goes_downwards(source, module):
    assert upward_imports(source, module) == []


def test_the_checker_resolves_relative_imports_of_a_package():
    names = [name for _, name in imported("from .base import A\nfrom ..x import B", ("hsed_jax", "physics"), True)]
    assert names == ["hsed_jax.physics.base.A", "hsed_jax.x.B"]


def test_the_checker_catches_private_jax():
    assert private_imports("from jax._src.core import Tracer")
    assert private_imports("import jax\nx = jax._src.core")
    assert not private_imports("from jax.core import Tracer\nimport jax.numpy as jnp")


@pytest.mark.parametrize(
    ("what", "not_needed"),
    [
        (
            "from hsed_jax.command_line import main\n"
            "assert main(['check', 'configs/paper.yaml', 'calibration.sampler=none']) == 2",
            {"jax", "equinox", "numpyro", "scipy", "pandas", "pint"},
        ),
        (
            "from hsed_jax.command_line import main\nassert main(['check', 'configs/paper.yaml']) == 0",
            {
                "pint",
                "scipy",
                "numpyro",
                "diffrax",
                "optimistix",
                "tinygp",
                "xarray",
                "matplotlib",
                "altair",
            },
        ),
        (
            "import hsed_jax.runs.reading, hsed_jax.reporting.report\n"
            "import hsed_jax.reporting.side_by_side, hsed_jax.study.own_parts",
            {"scipy.stats", "scipy.interpolate", "numpyro", "diffrax", "optimistix", "tinygp", "pint", "altair"},
        ),
    ],
    ids=["refusal", "check", "report"],
)
def test_a_quick_command_does_not_wait_for_packages_that_it_has_no_use_for(what, not_needed):
    code = f"import sys\n{what}\nprint('loaded:', *sorted({not_needed} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent, check=True)
    assert done.stdout.splitlines()[-1] == "loaded:"


def test_the_rooms_of_the_design_page_are_those_of_the_package_in_the_order_of_their_imports():
    page = (PACKAGE.parent / "docs" / "design.md").read_text(encoding="utf-8")
    table = page.split("| package | content |")[1].split("\n\n")[0]
    named = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    # Two of them are single modules: the figures of a notebook and the command line.
    assert set(named) == {*rooms, "plot", "command_line"}
    assert [LEVEL[room] for room in named] == sorted(LEVEL[room] for room in named)


@pytest.mark.whole
def test_run_is_a_function_also_after_somebody_imported_it_as_a_module():
    code = "import hsed_jax\n"
    for statement in ("import hsed_jax.run", "from hsed_jax.run import main"):
        code += f"try:\n    {statement}\nexcept ImportError as refused:\n    print(refused)\nprint(type(hsed_jax.run).__name__)\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent, check=True)
    first, kind, second, still = done.stdout.splitlines()
    assert (
        first == second
        and first.startswith("hsed_jax.run is a function, not a module")
        and "python -m hsed_jax.run" in first
    )
    assert kind == still == "function"


def test_run_is_a_command():
    done = subprocess.run(
        [sys.executable, "-m", "hsed_jax.run", "--help"], capture_output=True, text=True, cwd=PACKAGE.parent, check=True
    )
    assert done.stdout.startswith("usage: python -m hsed_jax.run")


def borrowed(source: str) -> list[str]:
    """What a test takes from another test, and objects that it makes without their own `__init__`."""
    faults = [name for _, name in imported(source, ("tests", "test_x")) if name.split(".")[0].startswith("test_")]
    made = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Attribute) and node.attr == "__new__")
    return faults + [ast.unparse(node) for node in made]


@pytest.mark.parametrize("path", sorted(TESTS.rglob("*.py")), ids=lambda path: path.name)
def test_a_test_needs_no_other_test_and_no_object_that_was_never_made(path):
    assert borrowed(path.read_text(encoding="utf-8")) == []


def test_the_folders_of_the_tests_are_those_of_the_repository():
    """A test is where what it tests is: in the folder of a package, of the benchmarks or of the documentation."""
    folders = {path.parent.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py")}
    assert folders <= {".", "benchmarks", "docs", *(path.parent.name for path in PACKAGE.glob("*/__init__.py"))}


@pytest.mark.parametrize("source", ["from test_a import B", "import test_a", "x = object.__new__(Fit)"])
def test_the_checker_catches_what_is_borrowed(source):
    assert borrowed(source)
