"""The two kinds of discrepancy behind one face: of quantities over the inputs, of histories over the cycles of the response."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference import discrepancy, discrepancy_over_cycles, learning_over_cycles
from hsed_jax.inference.discrepancy import Process, Support
from hsed_jax.inference.discrepancy_over_cycles import OverCycles
from hsed_jax.inference.likelihood import Data, Error
from hsed_jax.inference.posterior import Posterior

Discrepancy = Process | OverCycles


def none_yet(posterior: Posterior, data: Data) -> Data:
    """The data of a model that is not wrong, as a discrepancy will have them: one program serves both."""
    if not _is_of_histories(posterior):
        return data._replace(decorrelation=discrepancy.none_of(data))
    return data._replace(decorrelation=discrepancy_over_cycles.none_of(data, len(posterior.names)))


def learned(
    posterior: Posterior,
    data: Data,
    u: Float[Array, " p"],
    errors: Sequence[Error],
    support: Support | None,
    previous: Discrepancy | None,
) -> Discrepancy:
    """The discrepancy of a calibrated model.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        u: unconstrained coordinates of the MAP.
        errors: of the outputs; they say of which it is learned.
        support: what one of quantities is a function of.
        previous: where the search starts, too.
    """
    wrong = np.asarray([error.discrepancy for error in errors], dtype=bool)
    if _is_of_histories(posterior):
        assert not isinstance(previous, Process)
        return learning_over_cycles.learn(posterior, data, u, wrong, previous)
    assert support is not None and not isinstance(previous, OverCycles)
    return discrepancy.learn(posterior, data, u, wrong, support, previous)


def read_back(posterior: Posterior, arrays: Sequence[Array]) -> tuple[Discrepancy, list[Array]]:
    """A discrepancy that was kept as arrays, and those that follow it."""
    kind = OverCycles if _is_of_histories(posterior) else Process
    size = len(fields(kind))
    return kind(*arrays[:size]), list(arrays[size:])


def summary(found: Discrepancy, posterior: Posterior, support: Support | None) -> dict[str, dict[str, float]]:
    """The discrepancy in numbers: its `amplitude` by output, relative where the error is, else SI.  Of quantities its correlation
    `length` by input, in shares of the input's distribution; of histories, in `cycles` of the response, how long
    a `swing` takes and how long its `memory` is."""
    sizes = (np.asarray(found.amplitudes) * np.asarray(posterior.declared)).tolist()
    told = {"amplitude": dict(zip(posterior.outputs, sizes, strict=True))}
    if isinstance(found, OverCycles):
        swings, quality = float(found.swings), float(found.quality)
        return told | {"cycles": {"swing": 1 / swings, "memory": quality / (np.pi * swings)}}
    assert support is not None
    return told | {"length": dict(zip(support.names, np.asarray(found.lengths).tolist(), strict=True))}


def _is_of_histories(posterior: Posterior) -> bool:
    """Whether outputs are histories, of many samples each, and no quantities."""
    return posterior.groups.size > len(posterior.outputs)
