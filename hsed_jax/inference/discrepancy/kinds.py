"""The model discrepancy of a study: for quantities over the inputs, for histories over the cycles of the response."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.discrepancy import cycles, inputs, learning
from hsed_jax.inference.discrepancy.base import AbstractDiscrepancy
from hsed_jax.inference.discrepancy.cycles import OverCycles
from hsed_jax.inference.discrepancy.inputs import Process, Support
from hsed_jax.inference.likelihood import Data, Error
from hsed_jax.inference.posterior import Posterior


def none_yet(posterior: Posterior, data: Data) -> Data:
    """The data of a correct model in the form of data with a discrepancy, so that one program serves both."""
    if not _is_of_histories(posterior):
        return data._replace(decorrelation=inputs.none_of(data))
    return data._replace(decorrelation=cycles.none_of(data, len(posterior.names)))


def learned(
    posterior: Posterior,
    data: Data,
    u: Float[Array, " p"],
    errors: Sequence[Error],
    support: Support | None,
    previous: AbstractDiscrepancy | None,
) -> AbstractDiscrepancy:
    """The discrepancy of a calibrated model.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        u: unconstrained coordinates of the MAP.
        errors: of the outputs; they state the outputs with a learned discrepancy.
        support: the variables of a discrepancy of quantities.
        previous: another start of the search.
    """
    wrong = np.asarray([error.discrepancy for error in errors], dtype=bool)
    if _is_of_histories(posterior):
        assert previous is None or isinstance(previous, OverCycles)
        return learning.learn(posterior, data, u, wrong, previous)
    assert support is not None and (previous is None or isinstance(previous, Process))
    return inputs.learn(posterior, data, u, wrong, support, previous)


def read_back(posterior: Posterior, arrays: Sequence[Array]) -> tuple[AbstractDiscrepancy, list[Array]]:
    """A discrepancy from stored arrays, and the remaining arrays."""
    kind = OverCycles if _is_of_histories(posterior) else Process
    size = len(fields(kind))
    return kind(*arrays[:size]), list(arrays[size:])


def summary(found: AbstractDiscrepancy, posterior: Posterior, support: Support | None) -> dict[str, dict[str, float]]:
    """The discrepancy in numbers: its `amplitude` by output, relative where the error is, else SI, and its `reach`."""
    sizes = (np.asarray(found.amplitudes) * np.asarray(posterior.declared)).tolist()
    amplitude = {"amplitude": dict(zip(posterior.outputs, sizes, strict=True))}
    return amplitude | found.reach(() if support is None else support.names)


def _is_of_histories(posterior: Posterior) -> bool:
    """Whether outputs are histories with many samples each, instead of quantities."""
    return posterior.groups.size > len(posterior.outputs)
