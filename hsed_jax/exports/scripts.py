"""The two scripts of a material, from one list of commands: Tcl for OpenSees, Python for OpenSeesPy.

Each defines the material. If it is run alone, it loads the material cyclically and prints elongation and force.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

from hsed_jax.exports.counterparts import Command

_MODEL = [
    Command("wipe", ()),
    Command("model", ("basic", "-ndm", 1, "-ndf", 1)),
    Command("node", (1, 0.0)),
    Command("node", (2, 0.0)),
    Command("fix", (1, 1)),
]
_ANALYSIS = [
    Command("element", ("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)),
    Command("constraints", ("Lagrange",)),
    Command("numberer", ("Plain",)),
    Command("system", ("FullGeneral",)),
    Command("test", ("NormDispIncr", 1e-12, 100)),
    Command("algorithm", ("Newton",)),
    Command("integrator", ("LoadControl", 1.0)),
    Command("analysis", ("Static",)),
]
STEPS = 400
"""Steps from one peak of the driver to the next: the hysteretic materials of OpenSees are first order in the step."""


def peaks(reach: float) -> list[float]:
    """The peaks of the driver [m]: two cycles each at a quarter, a half and all of the largest elongation."""
    return [sign * share * reach for share in (0.25, 0.5, 1.0) for sign in (1.0, -1.0, 1.0, -1.0)] + [0.0]


def python_script(title: str, notes: Sequence[str], commands: Sequence[Command], reach: float) -> str:
    """The script for OpenSeesPy; `specimen(ops, tag)` in it defines the material."""
    made = "\n".join(f"    {_python(command, 'tag')}" for command in commands)
    body = "\n".join(f"    {_python(command)}" for command in _MODEL)
    after = "\n".join(f"    {_python(command)}" for command in _ANALYSIS)
    return f'''"""{title}

{_joined(notes, "")}"""


def specimen(ops, tag):
    """Define the material with this tag; its parts have the tags that follow."""
{made}


def loop(ops, path):
    """Elongations and forces along a path of elongations [m] that begins at zero."""
{body}
    specimen(ops, 1)
    # The series is zero from its last time on, so the last elongation stands there twice.
    ops.timeSeries("Path", 1, "-dt", 1.0, "-values", *path, path[-1])
    ops.pattern("Plain", 1, 1)
    ops.sp(2, 1, 1.0)
{after}
    found = [(0.0, 0.0)]
    for _ in path[1:]:
        if ops.analyze(1) != 0:
            raise RuntimeError(f"OpenSees did not converge at {{ops.nodeDisp(2, 1)}} m")
        found.append((ops.nodeDisp(2, 1), ops.eleResponse(1, "material", 1, "stress")[0]))
    return found


def cycles(peaks, steps={STEPS}):
    """A path to these peaks, one after the other."""
    path = [0.0]
    for peak in peaks:
        begin = path[-1]
        path += [begin + (peak - begin) * i / steps for i in range(1, steps + 1)]
    return path


def read(file):
    """A path from the first column of a CSV file [m]; it begins at zero."""
    with open(file, encoding="utf-8") as lines:
        words = [line.split(",")[0] for line in lines]
    return [float(word) for word in words if word[:1].isdigit() or word[:1] in ("-", ".")]


if __name__ == "__main__":
    import sys

    import openseespy.opensees as ops

    path = read(sys.argv[1]) if len(sys.argv) > 1 else cycles({peaks(reach)!r})
    for elongation, force in loop(ops, path):
        print(f"{{elongation:.9g}},{{force:.9g}}")
'''


def tcl_script(title: str, notes: Sequence[str], commands: Sequence[Command], reach: float) -> str:
    """The script for OpenSees; sourced where `tag` is set it defines the material with this tag, and nothing else."""
    made = "\n".join(_tcl(command, "$tag") for command in commands)
    body = "\n".join(f"    {_tcl(command)}" for command in _MODEL)
    after = "\n".join(_tcl(command) for command in _ANALYSIS)
    return f"""# {title}
#
{_joined(notes, "# ")}
set alone [expr {{![info exists tag]}}]
if {{$alone}} {{
    set tag 1
{body}
}}

{made}

if {{!$alone}} {{ return }}

set path [list 0.0]
foreach peak {{{" ".join(map(repr, peaks(reach)))}}} {{
    set begin [lindex $path end]
    for {{set i 1}} {{$i <= {STEPS}}} {{incr i}} {{
        lappend path [expr {{$begin + ($peak - $begin) * $i / {float(STEPS)}}}]
    }}
}}
timeSeries Path 1 -dt 1.0 -values {{*}}$path
pattern Plain 1 1 {{ sp 2 1 1.0 }}
{after}
puts "0,0"
foreach elongation [lrange $path 1 end] {{
    if {{[analyze 1] != 0}} {{ error "OpenSees did not converge at $elongation m" }}
    puts "$elongation,[lindex [eleResponse 1 material 1 stress] 0]"
}}
"""


def _python(command: Command, tag: str = "") -> str:
    words = _words(command, {1: tag} if tag else {}, lambda number: f"{tag} + {number - 1}")
    return f"ops.{command.name}({', '.join(repr(w) if quoted else w for w, quoted in words)})"


def _tcl(command: Command, tag: str = "") -> str:
    words = _words(command, {1: tag} if tag else {}, lambda number: f"[expr {{{tag} + {number - 1}}}]")
    return " ".join([command.name, *(word for word, _ in words)])


def _words(command: Command, whole: Mapping[int, str], part: Callable[[int], str]) -> Iterator[tuple[str, bool]]:
    """The arguments, and which are text; tags of materials relative to that of the assembly, if it has one."""
    for place, word in enumerate(command.words):
        if isinstance(word, str):
            yield word, True
        elif whole and isinstance(word, int) and (place == 1 or command.words[0] in ("Series", "Parallel")):
            yield whole.get(word) or part(word), False
        else:
            yield repr(word), False


def _joined(notes: Sequence[str], mark: str) -> str:
    return "".join(f"{mark}{note}\n" for note in notes)
