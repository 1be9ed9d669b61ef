"""The excitation of a study, built: its settings checked, its record read."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterator, Mapping
from typing import Any, cast

import jax.numpy as jnp
from jaxtyping import Array

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError, at
from hsed_jax.measurements import Campaign, parse_unit, read_history
from hsed_jax.measurements.header import Protocol
from hsed_jax.measurements.units import dimension_of
from hsed_jax.physics.declared import Declared, Setting
from hsed_jax.physics.excitations import EXCITATIONS, AbstractExcitation
from hsed_jax.physics.simulator import Parametrised
from hsed_jax.sections import InputEntry
from hsed_jax.study import parts

LOWEST = 1e-9
"""Quantile that counts as the largest value of an input."""


def protocol_of(study: Study, measured: Campaign | None) -> Protocol:
    """The excitation of the experiments of a study: measured, or else planned.

    Raises:
        UserError: planned elongations for a specimen in a structure, or together with measurements of a structure.
    """
    excitation = None if study.excitation is None else study.excitation.excitation
    planned = "ground_motion" if excitation is None else excitation.kind.protocol
    if excitation is not None and planned == "displacement":
        if study.structure is not None:
            raise UserError(
                f"structure: the elongation of the specimen alone is imposed (excitation.{excitation.name}), so leave the "
                "structure out"
            )
        if measured is not None and measured.protocol != planned:
            raise UserError(
                f"excitation.{excitation.name}: it imposes an elongation, but the protocol of the campaign {measured.name!r} is "
                f"{measured.protocol}"
            )
    return planned if measured is None else measured.protocol


def excitation_of(study: Study) -> Parametrised[AbstractExcitation] | None:
    """From inputs to the excitation of an experiment; None if every experiment brings its record.

    Raises:
        UserError: a setting is impossible, refers to an unknown input or one with another dimension, or a file cannot be
            read.
    """
    entry, inputs = study.excitation, study.inputs
    kind = None if entry is None else entry.excitation
    if entry is None or kind is None:
        return None
    where, settings = f"excitation.{kind.name}", dict(entry.settings)
    arrays: dict[str, Array] = {}
    if kind.of_file:
        columns = read_history(study.folder / settings.pop("file"), kind.of_file[1])
        arrays = {name: jnp.asarray(column) for name, column in zip(kind.of_file, columns, strict=True)}
    if fault := kind.impossible(settings):
        name, words = fault
        raise UserError(f"{where}.{name}: {words}")
    for name, known, value in _each(kind, settings):
        _check(f"{where}.{name}", known, value, inputs)
    values = {name: _stands_for(kind.settings[name], value) for name, value in settings.items()}
    return Parametrised(EXCITATIONS[kind.name], tuple(values.items()), arrays)


def _stands_for(known: Setting, value: Any) -> Any:
    """The value for a class: a word of a study could be the name of an input, but the value behind the word could not."""
    if value is not None and known.kind == "word":
        return known.words[value]
    return tuple(cast("list[Any]", value)) if isinstance(value, list) else value


def _each(kind: Declared, settings: Mapping[str, Any]) -> Iterator[tuple[str, Setting, Any]]:
    """Numbers and names of inputs that are given, each with its key."""
    for name, known in kind.settings.items():
        if settings[name] is None or known.kind == "word":
            continue
        if known.kind == "numbers":
            yield from ((f"{name}.{i}", known, value) for i, value in enumerate(settings[name]))
        else:
            yield name, known, settings[name]


def _check(where: str, known: Setting, value: float | str, inputs: Mapping[str, InputEntry]) -> None:
    article = "an" if known.meaning[0] in "aeiou" else "a"
    if not isinstance(value, str):
        if known.is_positive and not value > 0:
            raise UserError(f"{where}: {article} {known.meaning} is positive, but it is {value:g}")
        return
    if value not in inputs:
        known_inputs = ", ".join(inputs) or "none"
        raise UserError(f"{where}: it refers to {value!r}, which is not an input; inputs are {known_inputs}")
    if known.unit != "1":
        at(f"inputs.{value}.unit", parse_unit, inputs[value].unit, dimension_of(known.unit))
    if known.is_positive:
        lowest = float(parts.prior(f"inputs.{value}", inputs[value].prior).quantile(LOWEST))
        if not lowest > 0:
            raise UserError(
                f"inputs.{value}: {article} {known.meaning} is positive, but this distribution reaches {lowest:.3g}"
            )


def sentence_of(study: Study) -> str:
    """The excitation of the planned experiments of a study in words, without a full stop."""
    entry = study.excitation
    assert entry is not None and entry.excitation is not None
    return entry.excitation.sentence(entry.settings, entry.duration)
