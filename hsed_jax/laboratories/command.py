"""A command laboratory: any program that reads a request from its folder and writes its measurements there."""

import atexit
import re
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from shutil import rmtree, which
from typing import Any

from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.laboratories.answer import read_answer
from hsed_jax.laboratories.base import Measured
from hsed_jax.laboratories.process import run_program
from hsed_jax.laboratories.request import Programme
from hsed_jax.laboratories.sensors import Sensors

_NAME = re.compile(r"\{(\w+)\}")
WORDS = ("folder", "id", "python")
"""Names in a template besides inputs: the folder of the experiment, its id, and the Python that runs this package."""


def filled(template: Iterable[str], folder: Path, known: Mapping[str, Any]) -> list[str]:
    """The words of a template with replaced names in braces: the folder, the Python, and further known names."""
    values = {"folder": str(folder), "python": sys.executable}
    values |= {name: value if isinstance(value, str) else repr(value) for name, value in known.items()}
    return [_NAME.sub(lambda match: values.get(match[1], match[0]), word) for word in template]


@dataclass(frozen=True)
class CommandLaboratory:
    """Runs a program for each experiment, in a separate folder.

    The folder `<workspace>/E07-1` (first attempt at E07) receives `request.json`, `ground_motion.csv` and `.AT2`; the program
    leaves `record.csv` (or another format of records) and `quantities.json` or `.csv` there, whichever the sensors declare.
    Another attempt has another folder, so files of an unfinished attempt are never read.

    Attributes:
        template: the program and its arguments; {folder}, {id}, {python} and {NAME} of an input stand for their values.
        programme: common properties of the experiments.
        sensors: its measurements.
        timeout: [s] for one experiment.
        workspace: folder of the experiments' folders; None: a temporary one, until the end of the process.
        files: further files for the program, name and text.
    """

    template: tuple[str, ...]
    programme: Programme
    sensors: Sensors
    timeout: float
    workspace: Path | None = None
    files: Mapping[str, str] = field(default_factory=dict)

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        """Run the program for experiment `number` (from 0) at `inputs` (SI) and read its measurements.

        Raises:
            ExperimentFailed: the program failed or took too long, or its answer is missing or not a measurement.
        """
        request = self.programme.request(number, inputs)
        folder = self._new_folder(request.id)
        request.write(folder, self.sensors.channels, self.sensors.quantities)
        for name, text in self.files.items():
            write_whole(folder / name, text)
        run_program(filled(self.template, folder, {"id": request.id, **request.inputs}), folder, self.timeout)
        return read_answer(folder, request, self.sensors)

    @cached_property
    def _root(self) -> Path:
        if self.workspace is not None:
            return self.workspace.absolute()
        root = Path(tempfile.mkdtemp(prefix="laboratory-"))
        atexit.register(rmtree, root, ignore_errors=True)
        return root

    def _new_folder(self, name: str) -> Path:
        """A folder that did not exist before."""
        attempt = 1
        while True:
            folder = self._root / f"{name}-{attempt}"
            try:
                folder.mkdir(parents=True)
                return folder
            except FileExistsError:
                attempt += 1


def check_template(template: Sequence[str], inputs: Iterable[str], words: Iterable[str] = WORDS) -> None:
    """Refuse a template with unknown names.

    Raises:
        UserError: an unknown name in braces, with the allowed ones, or a program that does not exist.
    """
    known, program = (*words, *inputs), template[0]
    for word in template:
        for name in _NAME.findall(word):
            if name not in known:
                raise UserError(f"it contains {{{name}}}; allowed are {', '.join(f'{{{k}}}' for k in known)}")
    if "{" not in program and which(program) is None:
        raise UserError(f"there is no program {program} that may be executed")
