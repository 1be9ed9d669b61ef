"""The interactive part of the page: effects with check boxes, their parameters with sliders, the changing loop."""

from html import escape
from typing import Any, NamedTuple

import numpy as np
import panel as pn

from hsed_jax.app.explore import Dial, Explorer, Loop
from hsed_jax.app.fitting import Fitting
from hsed_jax.app.pieces import NONE_YET, Loops, attempt, html, note, widget
from hsed_jax.app.session import Session
from hsed_jax.physics.display import readable
from hsed_jax.physics.names import own_name, owner_of
from hsed_jax.reporting.style import words

# Step of a slider, as a share of its range.
_STEPS = 400


class _Asked(NamedTuple):
    """The requested simulation."""

    effects: tuple[str, ...]
    parameters: dict[str, float]
    experiment: str


class Effects:
    """Add and remove effects, and change their parameters."""

    def __init__(self, session: Session, fitting: Fitting):
        self._session, self._fitting = session, fitting
        self._explorer: Explorer | None = None
        self._opened = ""
        self._asked: _Asked | None = None
        self._is_busy = self._is_filling = False
        self._values: dict[str, float] = {}
        self._dials: tuple[str, ...] | None = None
        self._messages, self._error, self._loops = html(NONE_YET), html(), Loops(has_model=True, height=430)
        self._start = widget(pn.widgets.Select, name="start from", width=260)
        self._start.param.watch(self._started, "value")
        self._experiment = widget(pn.widgets.Select, name="experiment", width=260)
        self._experiment.param.watch(self._changed, "value")
        self._ticks = widget(pn.widgets.CheckBoxGroup, name="effects")
        self._ticks.param.watch(self._ticked, "value")
        self._sliders = pn.FlexBox(sizing_mode="stretch_width")
        self._fit = widget(
            pn.widgets.Button, name="Fit the model with these effects", button_type="primary", disabled=True
        )
        self._fit.on_click(self._fitted)
        left = pn.Column(self._start, self._experiment, html("<p>effects of the model</p>"), self._ticks, width=290)
        right = pn.Column(self._loops.pane, self._error, self._sliders, self._fit, sizing_mode="stretch_width")
        self._whole = pn.Row(left, right, sizing_mode="stretch_width", visible=False)
        self.view = pn.Column(
            html("<h2>Influence of an effect</h2>"
                 + note("Tick an effect: it joins the model, and the loop follows its sliders. Nothing is fitted here.")),
            self._messages,
            self._whole,
            sizing_mode="stretch_width",
        )  # fmt: skip
        session.param.watch(self._open, ["run", "shown", "ended"])

    async def _open(self, *events: Any) -> None:
        """Read the results of the run when this part is first shown: it takes a few seconds."""
        run = self._session.run
        if any(event.name == "ended" for event in events):
            self._opened = ""
        if self._session.shown != 3 or run == self._opened:
            return
        self._opened = run
        self._whole.visible, self._explorer = False, None
        if not run:
            self._messages.object = NONE_YET
            return
        self._messages.object = note("building the model …")
        explorer = await attempt(self._messages, lambda: Explorer(self._session.folder.inside(run)))
        if explorer is None:
            return
        self._explorer, self._is_filling = explorer, True
        self._values = {}
        self._experiment.options = list(explorer.experiments)
        self._experiment.value = self._experiment.options[0]
        self._ticks.options = {words(name): name for name in sorted(explorer.effects, key=_order(explorer))}
        self._start.options = list(explorer.starts)
        self._start.value = self._start.options[-1]
        self._is_filling = False
        self._whole.visible = True
        await self._started()

    async def _started(self, *_: Any) -> None:
        """Effects and parameters of a model of the run."""
        if self._explorer is None or self._is_filling:
            return
        start = self._explorer.starts[self._start.value]
        self._is_filling = True
        self._values = dict(start.parameters)
        self._ticks.value = list(start.effects)
        self._is_filling, self._dials = False, None
        await self._ticked()

    async def _ticked(self, *_: Any) -> None:
        explorer = self._explorer
        if explorer is None or self._is_filling:
            return
        effects = tuple(self._ticks.value)
        dials = await attempt(self._messages, lambda: explorer.variant(effects).dials)
        if dials is None or tuple(self._ticks.value) != effects:
            return
        self._sliders[:] = [self._slider(dial) for dial in dials]
        self._dials = tuple(dial.name for dial in dials)
        self._fit.disabled = not effects
        await self._changed()

    def _slider(self, dial: Dial) -> Any:
        value = self._values.setdefault(dial.name, dial.value)
        # The estimate may lie at the end of its prior, so the slider goes beyond it.
        low, high = min(dial.low, value if value > 0 else 1.5 * value), max(dial.high, 1.5 * value)
        divisor, unit = readable(dial.unit, np.asarray(high))
        owner = owner_of(dial.name)
        name = f"{words(owner)}: {own_name(dial.name)}" if owner else dial.name
        slider = widget(
            pn.widgets.FloatSlider,
            name=name + ("" if unit in ("1", "-") else f" [{unit}]"),
            start=low / divisor,
            end=high / divisor,
            value=value / divisor,
            step=(high - low) / divisor / _STEPS,
            format="0[.]00a" if high / divisor >= 1000 else "0[.]000" if high / divisor >= 0.1 else "0.00e+0",
            width=320,
        )

        async def moved(event: Any) -> None:
            self._values[dial.name] = event.new * divisor
            await self._changed()

        slider.param.watch(moved, "value")
        return pn.Column(slider, html(f'<p class="note">{escape(dial.meaning)}</p>'), width=340)

    async def _changed(self, *_: Any) -> None:
        """Simulate the last request; requests in the meantime are simulated only once."""
        if self._explorer is None or self._dials is None or self._is_filling:
            return
        self._asked = _Asked(
            tuple(self._ticks.value), {name: self._values[name] for name in self._dials}, self._experiment.value
        )
        if self._is_busy:
            return
        self._is_busy = True
        try:
            while (asked := self._asked) is not None:
                self._asked = None
                if (loop := await attempt(self._messages, self._simulated, self._explorer, asked)) is not None:
                    self._draw(self._explorer, asked, loop)
        finally:
            self._is_busy = False

    @staticmethod
    def _simulated(explorer: Explorer, asked: _Asked) -> Loop:
        return explorer.variant(asked.effects).simulate(asked.parameters, explorer.experiments[asked.experiment])

    def _draw(self, explorer: Explorer, asked: _Asked, loop: Loop) -> None:
        record = explorer.experiments[asked.experiment].record
        assert record is not None
        x, y = explorer.unit("elongation"), explorer.unit("force")
        measured = x.from_si(record["elongation"]), y.from_si(record["force"])
        pair = explorer.pair
        self._loops.measured([measured], f"{pair.elongation} [{x.text}]", f"{pair.force} [{y.text}]")
        self._loops.predicted(x.from_si(loop.elongation), y.from_si(loop.force))
        names = " and ".join(map(words, asked.effects)) or "no effect"
        self._error.object = f"<p>error <b>{loop.error:.3f}</b> with {escape(names)}</p>"

    async def _fitted(self, _: Any) -> None:
        """A run that adds the ticked effects to the model and fits it again."""
        run, folder = self._session.run, self._session.folder
        started = self._explorer.starts["the model as it was"].effects if self._explorer else ()
        added = [name for name in self._ticks.value if name not in started]
        if not added:
            self._messages.object = note("The model of this run has these effects already; tick another one.")
            return
        new = folder.name(folder.fresh("runs", f"{folder.inside(run).name}-with-{added[0]}"))
        options = ["steps=[calibrate, compare, improve]", f"improve.add=[{', '.join(added)}]"]
        if self._explorer is not None and self._explorer.is_measured:
            # From the run's own copy, because the measurements may have been moved, or chosen again.
            options.append("experiments.campaign=campaign")
        await self._fitting.follow(new, ["run", f"{run}/study.yaml", "--output", new, *options])


def _order(explorer: Explorer) -> Any:
    """Effects of the found models first, then by family and name."""
    found = {name for start in explorer.starts.values() for name in start.effects}
    return lambda name: (name not in found, explorer.catalogue[name].family, name)
