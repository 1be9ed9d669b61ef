"""A model that is a program: it reads a request in its folder and leaves its prediction there, as a laboratory does."""

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hsed_jax.drafts import write_whole
from hsed_jax.laboratories.answer import QUANTITIES, RECORD, columns_of, left
from hsed_jax.laboratories.command import filled
from hsed_jax.laboratories.process import run_program
from hsed_jax.physics.outputs import is_quantity

REQUEST, EXCITATION = "request.json", "excitation.csv"


@dataclass(frozen=True)
class Program:
    """Runs a program for each prediction, in a separate folder that is deleted afterwards.

    The folder receives `request.json` (parameters and inputs by name, inputs in SI, and the required quantities and channels)
    and, if the experiment has times, `excitation.csv` (`time` and the excitation, SI).  The program leaves `quantities.json`
    or `.csv`, and `record.csv` or another format of records with a row for each of those times.

    Attributes:
        template: the program and its arguments; {folder}, {python} and {NAME} of a parameter or input stand for their values.
        wanted: the quantities and channels to predict.
        timeout: [s] for one prediction.
    """

    template: tuple[str, ...]
    wanted: tuple[str, ...]
    timeout: float

    def __call__(self, parameters: Mapping[str, float], inputs: Mapping[str, Any]) -> dict[str, Any]:
        """The output of the program: numbers of quantities, arrays (n,) of channels.

        Raises:
            ExperimentFailed: it failed or took too long, or its output cannot be read.
        """
        numbers = {name: float(value) for name, value in inputs.items() if not np.ndim(value)}
        histories = {name: np.asarray(value) for name, value in inputs.items() if np.ndim(value)}
        quantities = [name for name in self.wanted if is_quantity(name)]
        channels = [name for name in self.wanted if not is_quantity(name)]
        request = {
            "parameters": dict(parameters),
            "inputs": numbers,
            "quantities": quantities,
            "channels": channels,
        }
        found: dict[str, Any] = {}
        with tempfile.TemporaryDirectory(prefix="model-") as name:
            folder = Path(name)
            write_whole(folder / REQUEST, json.dumps(request, indent=2, ensure_ascii=False) + "\n")
            if histories:
                write_whole(folder / EXCITATION, pd.DataFrame(histories).to_csv(index=False))
            run_program(filled(self.template, folder, {**numbers, **parameters}), folder, self.timeout)
            for names, files in ((quantities, QUANTITIES), (channels, RECORD)):
                if names:
                    found |= columns_of(left(folder, files), {name: name for name in names})
        return found
