"""Cycles and backbones of a campaign as tables in its declared units, for reports, spreadsheets and the page."""

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hsed_jax.measurements.backbones import Backbone, Which, backbone_of
from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.cycles import Cycles, cycles_of
from hsed_jax.measurements.units import DIMENSIONLESS
from hsed_jax.physics.names import named
from hsed_jax.physics.outputs import loops
from hsed_jax.tables import Table, Tabular

_SIDES = ("negative", "positive")


@dataclass(frozen=True, repr=False)
class Columns(Tabular):
    """A table of texts and numbers.

    Attributes:
        sentence: its content in words.
        heads: of the columns, with their units.
        rows: cells; NaN without a number.
    """

    sentence: str
    heads: list[str]
    rows: list[list[str | float]]

    def csv(self) -> str:
        """The table as comma-separated text; a cell without a number is empty."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.heads)
        writer.writerows([_exactly(cell) for cell in row] for row in self.rows)
        return text.getvalue()

    def cells(self) -> list[list[str]]:
        """The rows as they are shown: four digits, a dash without a number."""
        return [[_shown(cell) for cell in row] for row in self.rows]

    def _table(self) -> Table:
        return Table(self.sentence, self.heads, self.cells())


def cycle_table(campaign: Campaign) -> Columns:
    """Every cycle of every completed record that has force and elongation, in the declared units.

    Arguments:
        campaign: Not changed.  If only a part of a record is fitted or scored, the table has this part.

    Returns:
        A row per cycle: peaks, absorbed energy, equivalent viscous damping, stiffnesses, residual elongation and strength
        loss (definitions: `hsed_jax.measurements.cycles`), those of the negative side first.

    Example:
        >>> table = hx.cycle_table(hx.read_campaign("my_campaign"))
        >>> table.heads[:3]
        ['experiment', 'cycle', 'whole']
    """
    rows = [
        [*names, number + 1, "yes" if cycles.is_whole[number] else "no", *(float(column[number]) for column in columns)]
        for names, cycles in _loops(campaign)
        for columns in [_columns(cycles)]
        for number in range(len(cycles))
    ]
    e, f, energy, stiffness = _units(campaign)
    both = [("elongation", e), ("force", f)]
    heads = [*_heads(campaign), "cycle", "whole", *(f"{n}{s} [{unit}]" for n, unit in both for s in "-+")]
    heads += [f"energy [{energy}]", f"cumulative energy [{energy}]", "damping [1]", f"secant stiffness [{stiffness}]"]
    for name, unit in (("unloading stiffness", stiffness), ("reloading stiffness", stiffness), ("residual elongation", e),
                       ("strength loss", "1")):  # fmt: skip
        heads += [f"{name}{side} [{unit}]" for side in "-+"]
    return Columns(f"{len(rows)} cycles", _worded(campaign, heads), rows)


def backbone_table(campaign: Campaign) -> Columns:
    """The idealised backbones of every completed record that has force and elongation, in the declared units.

    Arguments:
        campaign: As of `cycle_table`.

    Returns:
        A row for each side, backbone (first cycles, stabilised) and idealisation (EEEP of ASTM E2126, bilinear of equal energy,
        a-b-c of ASCE/SEI 41) that has three points (`hsed_jax.measurements.backbones`).

    Example:
        >>> table = hx.backbone_table(hx.read_campaign("my_campaign"))
        >>> table.heads[:2]
        ['experiment', 'backbone']
    """
    rows: list[list[str | float]] = []
    whiches: tuple[Which, ...] = ("first", "stabilised")
    for names, cycles, force, elongation in _declared(campaign):
        for which in whiches:
            backbone = backbone_of(force, elongation, cycles, which)
            rows += [[*names, which, *row] for row in _idealised(backbone)]
    e, f, _, stiffness = _units(campaign)
    heads = [*_heads(campaign), "backbone", "side", "curve", f"yield elongation [{e}]", f"yield force [{f}]"]
    heads += [f"peak force [{f}]", f"ultimate elongation [{e}]", "failed", f"stiffness [{stiffness}]", "ductility [1]"]
    heads += [f"a [{e}]", f"b [{e}]", "c [1]"]
    return Columns(f"{len(rows)} idealised backbones", _worded(campaign, heads), rows)


def _idealised(backbone: Backbone) -> Iterator[list[str | float]]:
    for sign, side in zip((-1.0, 1.0), _SIDES, strict=True):
        for name, curve in (("EEEP", backbone.eeep(sign)), ("bilinear", backbone.bilinear(sign))):
            if curve is not None:
                yield [side, name, curve.yield_elongation, curve.yield_force, curve.peak_force, curve.ultimate_elongation,
                       "yes" if curve.failed else "no", curve.stiffness, curve.ductility, *[math.nan] * 3]  # fmt: skip
        if (component := backbone.asce41(sign)) is not None:
            yield [side, "a-b-c", component.yield_elongation, component.yield_force, component.peak_force,
                   component.ultimate_elongation, "yes" if component.failed else "no", component.stiffness,
                   component.ductility, component.a, component.b, component.c]  # fmt: skip


def _declared(campaign: Campaign) -> Iterator[tuple[list[str], Cycles, np.ndarray, np.ndarray]]:
    """Experiment (and specimen), cycles, force and elongation of every loop in the declared units of the first specimen."""
    owners = loops(campaign.channels)
    for experiment in campaign.completed:
        record = experiment.scored
        for owner in owners if record is not None else ():
            names = {name: named(owner, name) for name in ("force", "elongation")}
            if record is None or not set(names.values()) <= record.channels.keys() or len(record) < 3:
                continue
            first = {name: campaign.unit(named(owners[0], name)) for name in names}
            force, elongation = (first[name].from_si(record[channel]) for name, channel in names.items())
            if np.isfinite(force).all() and np.isfinite(elongation).all():
                yield [experiment.id, *([owner] if owner else [])], cycles_of(force, elongation), force, elongation


def _loops(campaign: Campaign) -> Iterator[tuple[list[str], Cycles]]:
    for names, cycles, _, _ in _declared(campaign):
        yield names, cycles


def _columns(cycles: Cycles) -> list[np.ndarray]:
    return [
        *cycles.elongation, *cycles.force, cycles.energy, cycles.cumulative_energy, cycles.damping, cycles.secant_stiffness,
        *cycles.unloading_stiffness, *cycles.reloading_stiffness, *cycles.residual, *cycles.strength_loss,
    ]  # fmt: skip


def _heads(campaign: Campaign) -> list[str]:
    return ["experiment", *(["specimen"] if any(loops(campaign.channels)) else [])]


def _units(campaign: Campaign) -> tuple[str, str, str, str]:
    """Units of elongation, force, energy and stiffness; with several specimens those of the first."""
    owners = loops(campaign.channels)
    if not owners:
        return "m", "N", "J", "N/m"
    e, f = (campaign.unit(named(owners[0], name)).text for name in ("elongation", "force"))
    return e, f, (f if e in DIMENSIONLESS else f"{f} {e}"), (f if e in DIMENSIONLESS else f"{f}/{e}")


def _worded(campaign: Campaign, heads: list[str]) -> list[str]:
    """Rotation and moment instead of elongation and force, where these were measured."""
    return [campaign.pair.words(head) for head in heads]


def _exactly(cell: str | float) -> str:
    return cell if isinstance(cell, str) else f"{cell:.8g}" if math.isfinite(cell) else ""


def _shown(cell: str | float) -> str:
    return cell if isinstance(cell, str) else f"{cell:.4g}" if math.isfinite(cell) else "–"
