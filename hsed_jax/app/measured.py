"""The first part of the page: the measurements, their columns, units and kind, with the loops in view."""

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn

from hsed_jax.app.drops import is_campaign, landed, lay_out, read_within, tables, taken_back
from hsed_jax.app.pieces import Loops, attempt, error, html, note, told, warnings, widget
from hsed_jax.app.session import Session
from hsed_jax.errors import UserError
from hsed_jax.intake.choice import HELD_OUT, Choice, campaign_of, chosen
from hsed_jax.intake.drifts import height_doubts
from hsed_jax.intake.opening import Gathered
from hsed_jax.intake.recognition import CHANNELS
from hsed_jax.measurements import Campaign, backbone_table, check_campaign, cycle_table, overview, write_campaign
from hsed_jax.physics.display import shown
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE

GRAVITY = 9.80665
"""[m/s²]"""
KINDS = {"cycles imposed on the specimen": "displacement", "shaken by the ground": "ground_motion"}
"""Kinds of test, in the words of the page."""
UNITS = {
    "time": ["s", "ms", "min", "hour"],
    "ground_acceleration": ["g", "m/s^2", "cm/s^2", "mm/s^2"],
    "elongation": ["mm", "cm", "m", "um", "inch", "ft", "rad", "mrad", "deg", "%", "-", "mm/m", "um/m"],
    "force": ["kN", "N", "MN", "daN", "kgf", "kip", "lbf", "kN*m", "N*m", "kN*mm", "kip*inch", "kip*ft", "MPa", "kPa", "Pa",
              "GPa", "ksi", "psi"],
}  # fmt: skip
"""Offered units; those of elongation and force also determine the pair, such as rotation and moment or strain and stress."""
_NONE, _NO_UNIT = "(none)", "(unit?)"
_TITLES = {"time": "time", "ground_acceleration": "ground acceleration", "elongation": "elongation", "force": "force"}


class Measured:
    """Drop or choose measurements, and assign the columns."""

    def __init__(self, session: Session):
        self._session = session
        self._where: Path | None = None
        self._landed: Path | None = None
        self._looking = asyncio.Lock()
        # The dropped files, and their copies in the folder.
        self._given: dict[str, bytes] = {}
        self._taken: dict[str, bytes] = {}
        # Content and fault of unusable files.
        self._refused: dict[str, tuple[bytes, str]] = {}
        self._found = Gathered({}, [], [])
        # The changes to the records when the campaign was made.
        self._done: list[str] = []
        self._campaign: Campaign | None = None
        self._is_declared = False
        self._is_filling = False
        self._messages, self._facts, self._loops = html(), html(), Loops(has_model=False)
        self._landing = pn.Column(sizing_mode="stretch_width")
        self._existing = widget(pn.widgets.Select, name="or measurements in this folder", width=420)
        self._existing.param.watch(self._open, "value")
        self._fill_choices()
        self._go = widget(
            pn.widgets.Button, name="Continue with these measurements", button_type="primary", disabled=True
        )
        self._go.on_click(self._write)
        over = widget(pn.widgets.Button, name="Start over")
        over.on_click(lambda _: self._clear())
        self._clear()
        self._below = pn.Column(
            pn.Row(pn.Column(self._form, width=430), pn.Column(self._loops.pane, sizing_mode="stretch_width")),
            self._facts,
            self._go,
            sizing_mode="stretch_width",
            visible=False,
        )
        intro = "<h2>What was measured?</h2>" + note(
            "Drop a file with a column of elongations and one of forces (text, .xlsx, .lvm, .tdms, .mat, .npz, .h5, .parquet), "
            "several such files of one specimen, or the files of a campaign folder. They are copied into this folder; "
            "nothing leaves this computer."
        )
        self.view = pn.Column(
            html(intro),
            self._landing,
            pn.Row(self._existing, pn.Column(pn.Spacer(height=16), over)),
            self._messages,
            self._below,
            sizing_mode="stretch_width",
        )

    def _fill_choices(self) -> None:
        """The widgets for the meaning of the columns."""
        self._kind = widget(pn.widgets.Select, name="kind of test", options=KINDS, width=400)
        self._columns: dict[str, Any] = {}
        self._units: dict[str, Any] = {}
        self._rows: dict[str, pn.Row] = {}
        for channel, title in _TITLES.items():
            self._columns[channel] = widget(pn.widgets.Select, name=f"column of the {title}", width=250)
            self._units[channel] = widget(
                pn.widgets.Select, name="unit", options=[_NO_UNIT, *UNITS[channel]], width=120
            )
            self._rows[channel] = pn.Row(self._columns[channel], self._units[channel])
        self._turned = widget(pn.widgets.CheckBoxGroup, options={"turn the sign of the elongation": "elongation",
                                                               "turn the sign of the force": "force"})  # fmt: skip
        self._tests = widget(pn.widgets.MultiChoice, name="keep for testing, never fitted", width=400)
        self._holds_out = widget(pn.widgets.Checkbox, name="keep the last third of each record for testing", value=True)
        self._drops = widget(pn.widgets.Checkbox, name="leave out samples that lack a channel")
        self._missing = widget(
            pn.widgets.TextInput, name="numbers that mark a missing sample, such as -9999; or none", width=400
        )
        chosen = [
            self._kind,
            *self._columns.values(),
            *self._units.values(),
            self._turned,
            self._tests,
            self._holds_out,
            self._drops,
            self._missing,
        ]
        for one in chosen:
            one.param.watch(self._chosen, "value")
        self._form = pn.Column(
            self._kind, *self._rows.values(), self._turned, self._tests, self._holds_out, self._drops, self._missing
        )

    def _clear(self) -> None:
        self._where, self._landed, self._found, self._campaign = None, None, Gathered({}, [], []), None
        self._fresh_dropper()
        there = self._session.folder.campaigns()
        self._existing.options = {"(choose)": "", **{name: name for name in there}}
        self._existing.value, self._existing.visible = "", bool(there)
        self._messages.object = ""
        if hasattr(self, "_below"):
            self._below.visible = False

    def _fresh_dropper(self) -> None:
        self._given, self._taken, self._refused = {}, {}, {}
        self._dropper = widget(pn.widgets.FileDropper, multiple=True, sizing_mode="stretch_width", min_height=90)
        self._dropper.param.watch(self._dropped, "value")
        self._landing[:] = [self._dropper]

    async def _dropped(self, event: Any) -> None:
        """Process all dropped files so far: files that are dropped together arrive one after the other."""
        async with self._looking:
            if event.obj is not self._dropper:
                return
            given = {
                name: content.encode() if isinstance(content, str) else content
                for name, content in self._dropper.value.items()
            }
            if given == self._given:
                return
            self._given = given
            if not given:
                self._clear()
                return
            found = await attempt(self._messages, self._land, given)
            with told(self._messages):
                if found is not None:
                    self._show(*found)
            if found is None or self._messages.object:
                self._campaign, self._below.visible = None, False

    def _land(self, given: dict[str, bytes]) -> tuple[Gathered, Campaign | None]:
        """Put the dropped files into the folder and read them.

        Raises:
            UserError: it cannot be read, or is an incomplete campaign, which is read again with the next file.
        """
        folder, declares = self._session.folder, is_campaign(given)
        # A record of a campaign need not be readable alone; other unreadable files are left out.
        used = given if declares else {n: c for n, c in given.items() if self._refused.get(n, ("",))[0] != c}
        if not used:
            raise UserError(self._refused[next(iter(given))][1])
        new = {name: content for name, content in used.items() if self._taken.get(name) != content}
        where = landed(folder, new, self._landed)
        taken_back(folder, where, self._taken.keys() - used.keys())
        try:
            declared = lay_out(folder, where) if declares else None
            found = Gathered({}, [], []) if declares else tables(where)
        except UserError as mistake:
            taken_back(folder, where, new)
            if not declares:
                self._refused |= {name: (content, str(mistake)) for name, content in new.items()}
            raise
        found.refused.extend(said for name, (_, said) in self._refused.items() if name in given and not declares)
        self._taken = used
        self._where = self._landed = where
        return found, declared

    async def _open(self, event: Any) -> None:
        if not event.new:
            return
        found = await attempt(self._messages, read_within, self._session.folder, event.new)
        if found is not None:
            # Files that are dropped from now on are other measurements.
            self._fresh_dropper()
            self._landed, (self._where, campaign) = None, found
            self._show(Gathered({}, [], []), campaign)

    def _show(self, found: Gathered, declared: Campaign | None) -> None:
        """Show the dropped files: a campaign has its declaration, and tables get a first guess."""
        self._found, self._is_declared = found, declared is not None
        self._below.visible, self._form.visible = True, declared is None
        self._done = []
        if declared is not None:
            self._look_at(declared)
            return
        first = next(iter(found.records.values()))
        choice, told = chosen(first)
        found.notes.extend(told.notes)
        self._is_filling = True
        for channel, columns in self._columns.items():
            columns.options = [_NONE, *first.names]
            columns.value = choice.columns.get(channel, _NONE)
            unit = choice.units.get(channel, _NO_UNIT)
            self._units[channel].options = list(dict.fromkeys([_NO_UNIT, *UNITS[channel], unit]))
            self._units[channel].value = unit
        self._kind.value = choice.protocol
        self._turned.value, self._tests.options, self._tests.value = [], list(found.records), []
        self._tests.visible = len(found.records) > 1
        self._is_filling = False
        self._chosen()

    def _chosen(self, *_: Any) -> None:
        if self._is_filling or not self._found.records:
            return
        wanted = CHANNELS[self._kind.value]
        for channel, row in self._rows.items():
            row.visible = channel in wanted
        columns = {c: self._columns[c].value for c in wanted if self._columns[c].value != _NONE}
        units = {channel: unit.value for channel, unit in self._units.items() if unit.value != _NO_UNIT}
        assert self._where is not None
        try:
            choice = Choice(
                self._kind.value,
                columns,
                units,
                frozenset(self._turned.value),
                frozenset(self._tests.value),
                HELD_OUT if self._holds_out.value else 0.0,
                _numbers(self._missing.value),
                self._drops.value,
            )
            made = campaign_of(self._where.name, self._found.records, choice)
            heights = [d for id, table in self._found.records.items() for d in height_doubts(id, table, choice)]
            self._done = [*made.notes, *map(str, heights)]
            self._look_at(made.campaign)
        except UserError as mistake:
            self._campaign, self._go.disabled = None, True
            self._loops.show(False)
            self._facts.object = error(str(mistake)) + warnings(self._found.left_out)

    def _look_at(self, campaign: Campaign) -> None:
        """Draw the loops and show the doubts, with the checks of every command."""
        pair = campaign.pair
        shown = [
            (
                campaign.unit("elongation").from_si(e.record["elongation"]),
                campaign.unit("force").from_si(e.record["force"]),
            )
            for e in campaign.completed
            if e.record is not None and {"elongation", "force"} <= e.record.channels.keys()
        ]
        if shown:
            x, y = campaign.unit("elongation").text, campaign.unit("force").text
            self._loops.measured(shown, f"{pair.elongation} [{x}]", f"{pair.force} [{y}]")
        self._loops.show(bool(shown))
        findings = check_campaign(campaign)
        faults = [str(finding) for finding in findings if finding.level == "error"]
        # One doubt stops every command, too.
        stops = faults + [str(finding) for finding in findings if finding.kind == "sign"]
        doubts = warnings(
            [*self._found.left_out, *self._done, *(str(finding) for finding in findings if str(finding) not in stops)]
        )
        hint = "" if self._is_declared else " Turn a sign, or choose another column, on the left."
        wrong = "".join(error(line + hint * (line not in faults)) for line in stops)
        fine = "" if findings else '<p class="good">The checks of the data found no doubts.</p>'
        numbers = replace(overview(campaign), sentence=_sentence(campaign)).html()
        self._facts.object = f"{wrong}{doubts}{fine}{numbers}{_cycles(campaign)}"
        self._campaign, self._go.disabled = campaign, bool(stops)

    async def _write(self, _: Any) -> None:
        campaign, where = self._campaign, self._where
        if campaign is None or where is None:
            return
        self._go.loading = True
        if not self._is_declared:
            await attempt(self._messages, write_campaign, campaign, where)
        self._go.loading = False
        if not self._messages.object:
            self._session.campaign = ""
            self._session.param.update(campaign=self._session.folder.name(where), shown=1)


def _cycles(campaign: Campaign) -> str:
    """The quantities of the cycles of a component test, in a closed fold."""
    if campaign.protocol != "displacement":
        return ""
    read = [columns._repr_html_() for columns in (cycle_table(campaign), backbone_table(campaign)) if columns.rows]
    return f"<details><summary>Cycles and backbones</summary>{''.join(read)}</details>" if read else ""


def _numbers(text: str) -> tuple[float, ...] | None:
    """Numbers that mark missing samples; None without a statement.

    Raises:
        UserError: a word is not a number.
    """
    words = text.replace(",", " ").split()
    try:
        return tuple(float(word) for word in words if word.lower() != "none") if words else None
    except ValueError:
        raise UserError(f"{text!r}: write numbers such as -9999, or none") from None


def _sentence(campaign: Campaign) -> str:
    count = len(campaign.completed)
    kind = next(words for words, protocol in KINDS.items() if protocol == campaign.protocol)
    held = f", {len(campaign.test)} of them kept for testing" if len(campaign.test) else ""
    what = f"{campaign.pair.elongation} and {campaign.pair.force}"
    said = f"{count} {'record' if count == 1 else 'records'} of {what}, {kind}{held}"
    forces = [
        np.abs(e.record["force"]).max()
        for e in campaign.completed
        if e.record is not None and "force" in e.record.channels
    ]
    if campaign.pair == ELONGATION_AND_FORCE and forces:
        # A weight shows a wrong unit (kN for N) most clearly.
        divisor, unit = shown(campaign.pair, "force", np.asarray(max(forces)))
        mass = max(forces) / GRAVITY
        weight = f"{mass / 1000:.3g} t" if mass >= 1000 else f"{mass:.3g} kg"
        said += f"; the largest force is {max(forces) / divisor:.3g} {unit}, the weight of {weight}"
    return f"{said}:"
