"""The declaration of a campaign, without its experiments: protocol, inputs, channels and quantities, each with its unit."""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from hsed_jax.errors import UserError
from hsed_jax.measurements.experiment import Channel
from hsed_jax.measurements.pairs import pair_of
from hsed_jax.measurements.tables import can_head_record
from hsed_jax.measurements.units import Unit, channel_dimension, parse_unit, quantity_dimension
from hsed_jax.physics.pairs import Pair

Protocol = Literal["ground_motion", "displacement"]

RESERVED_COLUMNS = ("id", "record", "status", "reason", "split", "from", "to")
"""Columns of experiments.csv that are neither inputs nor quantities nor metadata."""


@dataclass(frozen=True, repr=False)
class Header:
    """The declaration of a campaign.

    Attributes:
        name: Name of the tested object.
        protocol: `ground_motion`, or `displacement`: the elongation was imposed and the force measured.
        inputs: Unit of each variable input.
        channels: Channels of the records by canonical name.  Without `time` the row number is the time.
        quantities: Quantities of experiments.csv by canonical name.
        pair: The kind of elongation and force, from their units: rotation and moment, strain and stress, or just these.

    Raises:
        UserError: An unknown channel, a wrong unit, or units of no pair.
    """

    name: str
    protocol: Protocol
    inputs: dict[str, str] = field(default_factory=dict)
    channels: dict[str, Channel] = field(default_factory=dict)
    quantities: dict[str, Channel] = field(default_factory=dict)
    pair: Pair = field(init=False, compare=False)

    def __post_init__(self):
        """Check the declaration."""
        declared = {f"channels.{name}": c for name, c in self.channels.items()}
        declared |= {f"quantities.{name}": q for name, q in self.quantities.items()}
        object.__setattr__(self, "pair", pair_of(declared))
        object.__setattr__(self, "_units", units := _declared_units(self))
        said = {name: (float(units[name].factor), units[name].text) for name in (*self.channels, *self.quantities)}
        object.__setattr__(self, "pair", replace(self.pair, declared=said))

    def unit(self, name: str) -> Unit:
        """Return the declared unit of an input, channel or quantity; of `time`, seconds where it is the row number."""
        units: dict[str, Unit] = self.__dict__["_units"]
        if name not in units:
            raise UserError(f"the campaign declares no {name!r}; it declares {', '.join(units)}")
        return units[name]

    @property
    def has_time(self) -> bool:
        """Whether records have a time; otherwise the row number (from 0) is the time."""
        return "time" in self.channels


def check_column(name: str, where: str) -> None:
    """Raise `UserError` unless `name` can head a column of a table."""
    if not isinstance(name, str) or not name or name != name.strip() or not name.isprintable():
        raise UserError(
            f"{where}: {name!r} cannot head a column; a column is one line of text without blanks around it"
        )


def _declared_units(campaign: Header) -> dict[str, Unit]:
    """Check the declaration of a campaign and return the unit of every input, channel and quantity.

    Raises:
        UserError: With the name and unit, and what is allowed.
    """
    if campaign.protocol not in get_args(Protocol):
        raise UserError(f"protocol {campaign.protocol!r} is unknown; allowed: {', '.join(get_args(Protocol))}")
    units = {"time": parse_unit("s")}
    for kind, declared, dimension_of in (
        ("channels", campaign.channels, channel_dimension),
        ("quantities", campaign.quantities, quantity_dimension),
    ):
        columns: dict[str, str] = {}
        for name, channel in declared.items():
            where = f"{kind}.{name}"
            check_column(channel.column, where)
            if name != channel.name:
                raise UserError(f"{where}: it holds the channel {channel.name!r}; key and name must agree")
            if channel.column in columns:
                raise UserError(
                    f"{where}: column {channel.column!r} is also that of {columns[channel.column]}; one each"
                )
            if kind == "channels" and not can_head_record(channel.column):
                raise UserError(f"{where}: column {channel.column!r} looks like a number or comment; give it a name")
            columns[channel.column] = where
            try:
                units[name] = parse_unit(channel.unit, dimension_of(name, campaign.pair))
            except UserError as error:
                raise UserError(f"{where}: {error}") from None
    taken = {*RESERVED_COLUMNS, *(q.column for q in campaign.quantities.values())}
    if clash := set(RESERVED_COLUMNS) & {q.column for q in campaign.quantities.values()}:
        raise UserError(f"quantities: column {min(clash)!r} means something else in experiments.csv; rename the column")
    for name, unit in campaign.inputs.items():
        check_column(name, f"inputs.{name}")
        if name in taken or name in units:
            raise UserError(f"inputs.{name}: the name means something else (a column, channel or quantity); rename it")
        try:
            units[name] = parse_unit(unit)
        except UserError as error:
            raise UserError(f"inputs.{name}: {error}") from None
    if campaign.channels:
        needed = "elongation" if campaign.protocol == "displacement" else "time"
        if needed not in campaign.channels:
            raise UserError(f"channels: {needed!r} is missing; the protocol {campaign.protocol} needs it")
    return units
