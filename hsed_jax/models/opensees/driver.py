"""A script that imposes elongations on a material of OpenSees, request after request, until its standard input ends.

It does not use the package, so the Python with openseespy needs nothing else.  OpenSees is global to a process and prints
messages. Therefore the answers use the original standard output, and the messages of OpenSees go to a file, whose end is
reported if a request fails.

Its argument is the time limit of a simulation in seconds. A simulation that exceeds it by a second ends the process: an
exception is not sufficient, because the caller may have ended, and OpenSees may never return.

A request is a line of JSON, `{"material": ..., "arguments": [...], "points": n}`, and n doubles, the elongations.  An answer is a
line of JSON, `{"points": n}` or `{"error": ...}`, and n doubles, the forces.  The first answer is the version of OpenSees.
"""

import array
import json
import os
import signal
import sys
import tempfile
from importlib import import_module
from typing import IO, Any

_LAST = 300


def main() -> int:
    """Answer requests until there are no more."""
    seconds = int(sys.argv[1]) + 1
    answers = os.fdopen(os.dup(1), "wb")
    with tempfile.TemporaryFile() as printed:
        for stream in (1, 2):
            os.dup2(printed.fileno(), stream)
        ops: Any = import_module("openseespy.opensees")
        answer(answers, {"version": str(ops.version())})
        while line := sys.stdin.buffer.readline():
            request = json.loads(line)
            path = array.array("d")
            path.frombytes(sys.stdin.buffer.read(8 * request["points"]))
            start = os.lseek(1, 0, os.SEEK_END)
            signal.alarm(seconds)
            try:
                forces = forces_of(ops, request["material"], request["arguments"], path)
            except Exception as error:
                said = os.pread(1, 4000, start).decode(errors="replace").split()
                answer(answers, {"error": f"{error} {' '.join(said)}".strip()[-_LAST:]})
            else:
                answer(answers, {"points": len(forces)}, forces)
            signal.alarm(0)
            os.ftruncate(1, 0)
            os.lseek(1, 0, os.SEEK_SET)
    return 0


def forces_of(ops: Any, material: str, arguments: list[Any], path: array.array) -> array.array:
    """The forces of a new material along a path of elongations that begins at zero."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.uniaxialMaterial(material, 1, *arguments)
    ops.testUniaxialMaterial(1)
    found = array.array("d")
    for elongation in path:
        ops.setStrain(elongation)
        found.append(ops.getStress())
    return found


def answer(stream: IO[bytes], head: dict[str, Any], values: array.array | None = None) -> None:
    """Write an answer."""
    stream.write(json.dumps(head).encode() + b"\n" + (b"" if values is None else values.tobytes()))
    stream.flush()


if __name__ == "__main__":
    sys.exit(main())
