"""The canonical names of what is measured and predicted, with symbol, SI unit and meaning.  No other list exists."""

import re
from typing import NamedTuple


class Output(NamedTuple):
    """A channel (a history) or a quantity (one number per experiment)."""

    symbol: str
    unit: str
    meaning: str


QUANTITIES: dict[str, Output] = {
    "peak_force": Output(r"\max|r|", "N", "largest restoring force of the specimen"),
    "peak_elongation": Output(r"\max|\Delta u|", "m", "largest elongation of the specimen"),
    "dissipated_energy": Output(r"e(t_{end})", "J", "work done on the specimen until the end"),
}

CHANNELS: dict[str, Output] = {
    "time": Output("t", "s", "time"),
    "ground_acceleration": Output("a_g", "m/s^2", "acceleration of the ground"),
    "elongation": Output(r"\Delta u", "m", "elongation of the specimen"),
    "elongation_rate": Output(r"\Delta\dot u", "m/s", "rate of the elongation"),
    "force": Output("r", "N", "restoring force of the specimen"),
    "energy": Output("e", "J", "work done on the specimen so far"),
}
PER_MASS: dict[str, Output] = {
    "displacement": Output("u", "m", "displacement relative to the ground"),
    "velocity": Output(r"\dot u", "m/s", "velocity relative to the ground"),
    "acceleration": Output(r"\ddot u", "m/s^2", "acceleration relative to the ground"),
}


def output(name: str) -> Output:
    """Symbol, unit and meaning of a channel or quantity.

    Raises:
        KeyError: there is no such channel or quantity.
    """
    return QUANTITIES[name] if name in QUANTITIES else channel(name)


def channel(name: str) -> Output:
    """Symbol, unit and meaning of a channel.

    Raises:
        KeyError: there is no such channel.
    """
    if name in CHANNELS:
        return CHANNELS[name]
    match = re.fullmatch(r"(displacement|velocity|acceleration)_([1-9]\d*)(_absolute)?", name)
    if match is None:
        raise KeyError(name)
    kind, mass, absolute = match.groups()
    symbol, unit, meaning = PER_MASS[kind]
    if absolute:
        meaning = meaning.replace("relative to the ground", "absolute")
    mark = r",abs" if absolute else ""
    return Output(f"{symbol}_{{{mass}{mark}}}", unit, f"{meaning}, mass {mass}")
