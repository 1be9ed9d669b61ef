"""campaign.yaml: the declaration of a laboratory's measurements, and its allowed content."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from hsed_jax.errors import UserError
from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.experiment import Channel, Noise
from hsed_jax.measurements.header import Protocol
from hsed_jax.measurements.sheets import read_text
from hsed_jax.measurements.units import parse_unit
from hsed_jax.plain import Magnitude, dump_yaml, parse_yaml, shown


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, coerce_numbers_to_str=True, allow_inf_nan=False)


class NoiseEntry(_Strict):
    """``noise: 0.5``, a standard deviation in the channel's unit, or ``noise: {relative: 0.02}``, of the RMS."""

    absolute: Magnitude | None = None
    """Standard deviation in the unit of the channel; `noise: 0.5` is short for it."""
    relative: Magnitude | None = None
    """Standard deviation relative to the RMS of the channel, or to the value of the quantity."""


def _number_is_absolute(value: Any) -> Any:
    return value if isinstance(value, dict) else {"absolute": value}


class ChannelEntry(_Strict):
    """``{column: F, unit: kN, noise: 0.5}``; the column is called like the channel by default."""

    unit: str
    """Its unit."""
    column: str = ""
    """Its column; by default called like the channel or the quantity."""
    noise: Annotated[NoiseEntry, BeforeValidator(_number_is_absolute)] | None = None


class CampaignEntry(_Strict):
    """The whole file."""

    name: str
    protocol: Protocol
    inputs: dict[str, str] = Field(default_factory=dict)
    channels: dict[str, ChannelEntry] = Field(default_factory=dict)
    quantities: dict[str, ChannelEntry] = Field(default_factory=dict)


def read_declaration(path: Path) -> tuple[Campaign, dict[str, str]]:
    """Read campaign.yaml.

    Returns:
        A campaign without experiments, and by channel the column to read: its name, or its position from 1 where the
        records have no header.  In the campaign such a column is called like its channel.

    Raises:
        UserError: it is not YAML, or a key, channel or unit is unknown or missing; the message has the file, the key
            and the allowed values.
    """
    content = parse_yaml(read_text(path), str(path))
    if not isinstance(content, dict):
        raise UserError(f"{path}: expected keys and values; allowed keys: {', '.join(CampaignEntry.model_fields)}")
    content = {
        key: {} if value is None and key in ("inputs", "channels", "quantities") else value
        for key, value in content.items()
    }
    try:
        entry = CampaignEntry.model_validate(content)
    except ValidationError as error:
        raise UserError(f"{path}: {_sentence(error)}") from None
    try:
        header = Campaign(
            entry.name,
            entry.protocol,
            entry.inputs,
            {name: declared_channel(f"channels.{name}", name, c) for name, c in entry.channels.items()},
            {name: declared_channel(f"quantities.{name}", name, c) for name, c in entry.quantities.items()},
            source=str(path.parent),
        )
        if not header.channels and not header.quantities:
            raise UserError("neither channels nor quantities are declared; declare the measurements")
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    return header, {name: channel.column or name for name, channel in entry.channels.items()}


def write_declaration(campaign: Campaign) -> str:
    """Return the text of campaign.yaml for a campaign."""

    def entry(channel: Channel) -> dict[str, Any]:
        said: dict[str, Any] = {"column": channel.column, "unit": channel.unit}
        if channel.noise is not None and channel.noise.relative is not None:
            said["noise"] = {"relative": channel.noise.relative}
        elif channel.noise is not None:
            said["noise"] = float(campaign.unit(channel.name).from_si(channel.noise.absolute))
        return said

    content: dict[str, Any] = {"name": campaign.name, "protocol": campaign.protocol, "inputs": dict(campaign.inputs)}
    content["channels"] = {name: entry(channel) for name, channel in campaign.channels.items()}
    if campaign.quantities:
        content["quantities"] = {name: entry(channel) for name, channel in campaign.quantities.items()}
    return dump_yaml(content)


def declared_channel(where: str, name: str, entry: ChannelEntry) -> Channel:
    """The channel or quantity that an entry declares, its noise in SI; a column that is given by its position has the
    position as its name.

    Raises:
        UserError: an unknown unit or an impossible noise, with `where`, the path of the entry, in front.
    """
    try:
        noise = None
        if entry.noise is not None:
            absolute = entry.noise.absolute
            noise = Noise(
                None if absolute is None else float(parse_unit(entry.unit).to_si(absolute)), entry.noise.relative
            )
        column = "" if "channels." in where and entry.column.isdecimal() else entry.column
        return Channel(name, entry.unit, column, noise)
    except UserError as error:
        raise UserError(f"{where}: {error}") from None


def _sentence(error: ValidationError) -> str:
    """The first fault that pydantic found: the key, the fault, and the allowed values."""
    fault = error.errors()[0]
    path = [str(part) for part in fault["loc"]]
    where, given = ".".join(path), shown(fault["input"])
    model = CampaignEntry
    if path[0] in ("channels", "quantities"):
        model = NoiseEntry if "noise" in path[2:-1] else ChannelEntry
    allowed = ", ".join(model.model_fields)
    if fault["type"] == "extra_forbidden":
        return f"unknown key {where!r}; allowed here: {allowed}"
    if fault["type"] == "missing":
        return f"key {where!r} is missing; needed or allowed here: {allowed}"
    if fault["type"] in ("model_type", "dict_type"):
        return f"{where}: {given} is not a mapping; write it as {{{allowed if path[1:] else 'name: ...'}}}"
    return f"{where}: {given} is not allowed; {fault['msg'][0].lower()}{fault['msg'][1:]}"
