"""Writes the catalogue of effects: `docs/effects.md` and a figure of each in `docs/images/effects/`.

    python docs/effects.py

The content comes from the effects themselves; `--text` leaves the figures unchanged.
"""

import argparse
import inspect
import io
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image

from hsed_jax.analysis.form_curves import curves_of
from hsed_jax.config.load import load_study
from hsed_jax.inference.priors import Prior
from hsed_jax.physics import display
from hsed_jax.physics.effects import EFFECTS, AbstractEffect, AbstractSpringEffect
from hsed_jax.physics.effects.base import MULTIPLIED
from hsed_jax.physics.effects.forms import DRIVERS, forms_of, slots_of
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.laws import Elastic
from hsed_jax.physics.parameters import Parameter, PhysicalForm, parameters_of
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Recorded, Simulator, Timeline
from hsed_jax.reporting import style
from hsed_jax.reporting.style import Picture
from hsed_jax.study.build import Built

DOCS = Path(__file__).resolve().parent
PAGE, IMAGES = DOCS / "effects.md", DOCS / "images" / "effects"

# The component test of the figures: cycles of growing amplitude.
A, BETA = 2.0e6, 40.0  # N/m, 1/m: a strength of 50 kN, reached around 25 mm
AMPLITUDES, PERIOD, STEP = (0.02, 0.04, 0.06), 1.0, 0.005  # m, s, s
# The size that is shown: this quantile of the prior of the first parameter.
SIZE = 0.9
# … or these, if that quantile would show too little or too much.
SHOWN: dict[str, dict[str, float]] = {
    "slip": {"delta": 0.4},
    "fracture": {"delta": 0.7, "life": 5.0},
    "force_drift": {"delta": 1.0},
    "force_gain": {"delta": 0.2},
    "elongation_gain": {"delta": 0.3},
    "ground_motion_gain": {"delta": 0.3},
}

SYMBOLS = ("F_c", "u_c", "v_c", "E_c")

HEAD = """\
# The catalogue of physical effects

*Written by `python docs/effects.py` from the code; not to be edited by hand.*

A study adds an effect under `model: effects:`, such as `effects: {{stiffness_degradation: {{}}}}`. A diagnosis considers
every effect that the measurements can show. `hsed effects NAME` prints an entry of this page in a terminal.

The plain law is that of Bouc and Wen with the force $r = z$. Effects write to named slots of it,

$$\\dot z = h\\,\\frac{{a A - \\nu\\,(\\beta\\,\\mathrm{{sign}}(\\Delta\\dot u\\,z)+\\gamma)\\,|z|^n}}{{\\eta}}\\,\\Delta\\dot u,
\\qquad r = z + \\sum \\text{{force}},$$

or to the structure and the test rig. [Other laws](laws.md) have some of these slots. The values that several effects write
to one slot are multiplied or added, so their order does not matter. At its neutral value an effect changes nothing.

- **Forms and drivers.** Many effects have several published formulas, and some a choice of the driver, the $x$ of the
  equations. A study chooses them by `form` and `driver` ([settings](settings.md#forms-of-an-effect)); the defaults are the
  first ones. A diagnosis considers all of them. It reports the effect and its form.
- **Units.** Characteristic values of the campaign make the amplitudes dimensionless: force $F_c$ [N], elongation $u_c$
  [m], rate of elongation $v_c$ [m/s] and absorbed energy $E_c$ [J]. If the table gives a physical unit, a study may use
  that name instead, in SI units. This is not allowed with another driver, or in a form that changes the unit. Energy is
  the total work of the spring, $e = \\int r\\,d\\Delta u$ [J]. Other authors leave out the elastic part or divide by
  the mass, and their numbers differ accordingly.
- **Priors** are defaults; a study may give others.
- **Figures.** Grey: the plain law. Blue: with the effect. Its first parameter is at the {share:.0f} % quantile of its prior
  and the others are at their defaults, or as stated below the figure. Loops are those of a component test with three cycles
  of growing amplitude (A = 2000 kN/m, β = 40 1/m, γ = 0, n = 1). Effects without influence on a component test are shown by
  the elongation of the specimen in the shaken structure of `configs/hidden_effect.yaml`.
"""

DRIVER_TABLE = """\
## Drivers

| driver | meaning | $x$ |
|---|---|---|
"""

LOOK_ALIKES = """\
## Similar effects

Some effects cannot be distinguished by some measurements, even with the best accuracy. A diagnosis then reports
`ambiguous`, with the rivals and the experiment that separates them. The usual cases are:

- **Stiffness and strength.** A decay of A, as in `peak_softening`, lowers the initial slope and the ultimate force together.
  To first order it equals `strength_degradation` plus `stiffness_degradation`. Loops well beyond yield separate them.
- **Delay and damping.** At one frequency a delay acts like a dashpot; it acts like a negative dashpot if the late
  signal is fed back to the structure, as in hybrid simulation. `actuator_delay`, `time_offset` and `viscous_damping`
  need more than one frequency, or a known clock.
- **Load cell and specimen.** With n = 1 `force_gain` is a factor on A; with another n it changes β and γ too. Only a second
  measurement of the force separates them.
- **β, γ and n at one amplitude.** They change one loop in nearly the same way; published correlations are 0.998 and more.
  `loop_shape` and `yield_sharpness` need cycles of several amplitudes.
- **Pinching and softness.** In small cycles `pinching` and `slip` are only a softer spring.
- **Friction and a small loop.** `coulomb_friction` is the limit of a very stiff hysteretic spring that yields at once. Its
  corners, or a change of speed (`stribeck_friction`, `viscous_damping`), separate them.
"""

OWN = '''\
## An effect of your own

A study can add a Python file to its catalogue: `model: {own_effects: [mine.py]}`, relative to the study
([execution of code](laboratories.md#execution-of-code)). All commands then have its effects, also `hsed effects NAME
--study STUDY.yaml --trust`. One class is one effect. Its first parameter is the amplitude, which is zero without the
effect. The effect contributes to the slots of the equation above.

```python
from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, register
from hsed_jax.physics.parameters import PhysicalForm, parameter


@register
@final
class Wave(AbstractSpringEffect):
    r"""A force that waves with the elongation: $\\delta F_c\\sin(3\\Delta u/u_c)$."""

    name: ClassVar[str] = "wave"
    family: ClassVar[str] = "post-yield"
    reference: ClassVar[str] = "our own tests"

    delta: float = parameter(
        r"\\delta_w",
        "1",
        "wave over characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("force", "N", lambda scales: scales.force),
    )

    def contribute(self, point):
        """An addend to the force."""
        return {"force": self.delta * point.scales.force * jnp.sin(3 * point.elongation / point.scales.elongation)}
```
'''


def page() -> str:
    """The text of `docs/effects.md`."""
    families: dict[str, list[str]] = {}
    for name, effect in EFFECTS.items():
        families.setdefault(effect.family, []).append(name)
    index = ["| family | effects |", "|---|---|"]
    index += [f"| {f} | {', '.join(f'[`{n}`](#{n})' for n in names)} |" for f, names in families.items()]
    rows = [f"| `{key}` | {driver.words} | ${_in_a_cell(driver.measure)}$ |" for key, driver in DRIVERS.items()]
    parts = [
        HEAD.format(share=100 * SIZE),
        "\n".join(index) + "\n",
        DRIVER_TABLE + "\n".join(rows) + "\n",
        LOOK_ALIKES,
        OWN,
    ]
    for family, names in families.items():
        parts.append(f"## Family: {family}\n")
        parts += [_entry(name) for name in names]
    return _for_markdown("\n".join(parts))


def _for_markdown(text: str) -> str:
    """Spaces in formulas by name: Markdown would eat the backslash before punctuation."""
    return text.replace("\\,", "\\thinspace ").replace("\\!", "\\negthinspace ")


def _in_a_cell(formula: str) -> str:
    """The formula without bars, which would end a cell of a table."""
    return formula.replace("|", "\\vert ")


def _entry(name: str) -> str:
    effect = EFFECTS[name]
    known = parameters_of(effect)
    shown = ", ".join(f"${known[key].symbol}$ = {value:.2g}" for key, value in medium(name).items())
    alt = f"Plain law in grey and with {name} in blue"
    rows = [
        "| parameter | symbol | meaning | neutral | range | prior | physical unit |",
        "|---|---|---|---|---|---|---|",
    ]
    rows += [_row(parameter) for parameter in known.values() if not parameter.shapes]
    limits = [
        said
        for is_so, said in (
            (effect.shaken_only, "no influence on a component test"),
            (effect.needs_time, "needs a time scale"),
            (effect.histories_only, "visible in histories, not in quantities"),
            (
                getattr(effect, "linear_only", False),
                "only for linear springs (`spring_1.yielding`) and the law `elastic`",
            ),
        )
        if is_so
    ]
    return "\n".join(
        [
            f"### {name}",
            "",
            f"![{alt}](images/effects/{name}.png)",
            "",
            inspect.cleandoc(effect.__doc__ or ""),
            "",
            *rows,
            "",
            *_forms(effect),
            *_drivers(effect),
            f"Acts on: {effect.place}, {_written(effect)}{''.join(f'; {said}' for said in limits)}. "
            f"Reference: {effect.reference}. In the figure: {shown}.",
            "",
        ]
    )


def _written(effect: type[AbstractEffect]) -> str:
    """The slots that it writes to, in any form."""
    slots = dict.fromkeys(slot for label in forms_of(effect) for slot in slots_of(effect, label))
    return " or ".join(f"{'a factor on' if slot in MULTIPLIED else 'an addend to'} `{slot}`" for slot in slots)


def _forms(effect: type[AbstractEffect]) -> list[str]:
    """The table of its forms, and that of the free parameters of some of them."""
    if not effect.forms:
        return []
    known, rows = parameters_of(effect), []
    # An effect outside the spring has no state to be drawn over.
    if issubclass(effect, AbstractSpringEffect):
        name, curves = effect.name, curves_of(effect)
        across = re.sub(r"[uvF]_c", r"$\g<0>$", curves.across)
        rows += [f"![Forms of {name}](images/effects/{name}_forms.png)", ""]
        rows += [f"{curves.what.capitalize()} against {across}. Each curve has its own scale.", ""]
    rows += ["| form | equation | free | fixed | source |", "|---|---|---|---|---|"]
    for form in effect.forms:
        frees = ", ".join(f"`{key}`" for key in form.free) or "–"
        held = [f"`{key}` = {value:g}" for key, value in form.held.items() if not known[key].shapes]
        equation = f"${_in_a_cell(form.equation)}$" if form.equation else "as above"
        rows.append(f"| `{form.name}` | {equation} | {frees} | {', '.join(held) or '–'} | {form.reference or '–'} |")
    freed = {key for form in forms_of(effect).values() for key in form.free}
    if freed:
        rows += ["", "| parameter of forms | symbol | meaning | default | range | prior | physical unit |"]
        rows += ["|---|---|---|---|---|---|---|", *(_row(known[key]) for key in known if key in freed)]
    return [*rows, ""]


def _drivers(effect: type[AbstractEffect]) -> list[str]:
    """Its possible drivers, the default one first."""
    if not effect.drivers:
        return []
    return [f"[Driver](#drivers) $x$: {', '.join(f'`{key}`' for key in effect.drivers)}.", ""]


def _row(known: Parameter) -> str:
    low, high = (f"{bound:g}" if math.isfinite(bound) else "∞" for bound in (known.lower, known.upper))
    low = "−∞" if low == "∞" else low
    bounds = "any" if (low, high) == ("−∞", "∞") else f"{low} to {high}"
    prior = ", ".join(f"`{kind}` {_arguments(given)}" for kind, given in (known.prior or {}).items())
    physical = "–" if known.physical is None else _physical(known, known.physical)
    meaning = known.meaning.replace("|", "\\|")
    cells = (f"`{known.name}`", f"${known.symbol}$", meaning, f"{known.neutral:g}", bounds, prior, physical)
    return f"| {' | '.join(cells)} |"


def _arguments(given: object) -> str:
    if isinstance(given, Mapping):
        return ", ".join(f"{key} {value:g}" for key, value in given.items())
    return ", ".join(f"{value:g}" for value in given) if isinstance(given, list | tuple) else f"{given:g}"


def _physical(known: Parameter, form: PhysicalForm) -> str:
    """``eta`` = δ/E_c [1/J]: the factor is a product of powers of the characteristic values, found by doubling each."""
    ones = np.ones(len(SYMBOLS))
    coefficient = float(form.factor(Scales(*ones)))
    powers = [
        round(math.log2(float(form.factor(Scales(*np.where(np.arange(4) == i, 2.0, 1.0)))) / coefficient))
        for i in range(len(SYMBOLS))
    ]

    def product(sign: int) -> list[str]:
        return [f"{s}^{{{abs(p)}}}" if abs(p) > 1 else s for s, p in zip(SYMBOLS, powers, strict=True) if sign * p > 0]

    above, below = product(1), product(-1)
    if coefficient < 1:
        below = [f"{1 / coefficient:g}", *below]
    elif coefficient > 1:
        above = [f"{coefficient:g}", *above]
    over = "\\,".join([known.symbol, *above])
    under = "" if not below else "/" + (below[0] if len(below) == 1 else f"({'\\,'.join(below)})")
    return f"`{form.name}` = ${over}{under}$ [{form.unit}]"


def medium(name: str) -> dict[str, float]:
    """The shown size of an effect, by parameter."""
    if name in SHOWN:
        return SHOWN[name]
    first = next(iter(parameters_of(EFFECTS[name]).values()))
    ((kind, given),) = (first.prior or {}).items()
    return {first.name: float(Prior(kind, given).quantile(SIZE))}


def draw() -> None:
    """Write the figure of every effect."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    for old in IMAGES.glob("*.png"):
        old.unlink()
    test, shaken = ComponentTest(), Shaken()
    for name, effect in EFFECTS.items():
        size = {f"{name}.{key}": value for key, value in medium(name).items()}
        picture = (shaken if effect.shaken_only else test).picture(name, size)
        _save(picture, name)
        if effect.forms and issubclass(effect, AbstractSpringEffect):
            _save(_forms_picture(name), f"{name}_forms")


def _save(picture: Picture, name: str) -> None:
    buffer = io.BytesIO()
    picture.figure.savefig(buffer, format="png", dpi=120)
    # Few colours in a palette: a quarter of the size.
    Image.open(buffer).convert("RGB").quantize(48).save(IMAGES / f"{name}.png", optimize=True)


@style.in_house_style
def _forms_picture(name: str) -> Picture:
    """The forms of an effect side by side."""
    effect = EFFECTS[name]
    assert issubclass(effect, AbstractSpringEffect)
    _, across, places, curves = curves_of(effect)
    figure = style.new_figure(1.3)
    figure.set_size_inches(1.25 * len(curves) + 0.3, 1.3)
    for panel, (label, values) in zip(figure.subplots(1, len(curves), squeeze=False)[0], curves.items(), strict=True):
        panel.plot(places, values, color=style.BLUE, linewidth=1.2)
        panel.set(xticks=[], yticks=[], title=label)
        panel.title.set_fontsize(7)
        panel.margins(y=0.2)
    return Picture(figure, f"{name}: its forms over {across}.", f"{len(curves)} curves, {name}.")


class ComponentTest:
    """The spring alone, cycled."""

    def __init__(self):
        steps = round(len(AMPLITUDES) * PERIOD / STEP)
        time = 0.5 * STEP * np.arange(2 * steps + 1)
        omega = 2 * np.pi / PERIOD
        size = np.asarray(AMPLITUDES)[np.minimum((time / PERIOD).astype(int), len(AMPLITUDES) - 1)]
        path = Imposed(size * np.sin(omega * time), size * omega * np.cos(omega * time))
        self.conditions = Conditions({}, Recorded(Tabulated(path), np.full(steps, STEP)))
        self.constants = (("A", A), ("beta", BETA), ("gamma", 0.0), ("n", 1.0))
        self.simulator = Simulator(None, None, Timeline(STEP, steps), constants=self.constants)
        self.plain = _respond(self.simulator, {}, self.conditions)
        self.scales = _scales(self.plain)

    def picture(self, name: str, size: Mapping[str, float]) -> Picture:
        """The loop, plain and with the effect."""
        simulator, plain = self.simulator, self.plain
        if getattr(EFFECTS[name], "linear_only", False):
            simulator = replace(simulator, elements=(Element(law=Elastic),), constants=(("k", A),))
            plain = _respond(simulator, {}, self.conditions)
        simulator = replace(simulator, effects=EFFECTS.only([name]), scales=self.scales)
        changed = _respond(simulator, size, self.conditions)
        curves = [(channels["elongation"], channels["force"]) for channels in (plain, changed)]
        return _picture(name, curves, ("elongation", "m"), ("force", "N"))


class Shaken:
    """The specimen in the structure of the paper, at the central inputs."""

    def __init__(self):
        study = load_study(DOCS.parent / "configs" / "hidden_effect.yaml")
        built = Built(study)
        space = built.experiments.space
        middle = space.si(space.declared(np.full((1, len(space.names)), 0.5)))
        self.conditions = Conditions({key: jnp.asarray(values[0]) for key, values in middle.items()})
        self.law = {k: v for k, v in built.site.laboratory.parameters.items() if "." not in k}
        self.simulator = replace(built.simulation.simulator, effects=EFFECTS.only([]), constants=())
        self.plain = _respond(self.simulator, self.law, self.conditions)
        step, _, every = self.simulator.timeline
        self.time = step * every * np.arange(len(self.plain["elongation"]))

    def picture(self, name: str, size: Mapping[str, float]) -> Picture:
        """The elongation over time, plain and with the effect."""
        simulator = replace(self.simulator, effects=EFFECTS.only([name]), scales=_scales(self.plain))
        changed = _respond(simulator, {**self.law, **size}, self.conditions)
        return _picture(
            name, [(self.time, c["elongation"]) for c in (self.plain, changed)], ("time", "s"), ("elongation", "m")
        )


def _respond(simulator: Simulator, parameters: Mapping[str, float], conditions: Conditions) -> dict[str, np.ndarray]:
    names = ("elongation", "elongation_rate", "force", "energy")
    known = {key: jnp.asarray(value) for key, value in parameters.items()}
    channels = jax.jit(lambda p, c: simulator.respond(p, c, names).channels)(known, conditions)
    return {key: np.asarray(values) for key, values in channels.items()}


def _scales(channels: Mapping[str, np.ndarray]) -> Scales:
    force, elongation, rate = (float(np.max(np.abs(channels[k]))) for k in ("force", "elongation", "elongation_rate"))
    return Scales(force, elongation, rate, float(channels["energy"][-1]))


@style.in_house_style
def _picture(name: str, curves: list, x: tuple[str, str], y: tuple[str, str]) -> Picture:
    figure = style.new_figure(2.1)
    figure.set_size_inches(3.0 if x[0] == "elongation" else 4.4, 2.1)
    panel = figure.subplots()
    labels = []
    for channel, unit, values in ((*x, [c[0] for c in curves]), (*y, [c[1] for c in curves])):
        divisor, shown = display.readable(unit, *values)
        labels.append((divisor, "Time [s]" if channel == "time" else style.channel_label(channel, shown)))
    looks = ({"color": style.GREY, "linewidth": 1.0}, {"color": style.BLUE, "linewidth": 1.2})
    for (u, v), look in zip(curves, looks, strict=True):
        panel.plot(u / labels[0][0], v / labels[1][0], **look)
    panel.set(xlabel=labels[0][1], ylabel=labels[1][1])
    return Picture(figure, f"{name}: plain law (grey) and with the effect (blue).", f"Two curves, {name}.")


def main() -> None:
    """Write the page and, unless `--text` is given, the figures."""
    parser = argparse.ArgumentParser(description="Write docs/effects.md and its figures.")
    parser.add_argument("--text", action="store_true", help="the page alone, without the figures")
    if not parser.parse_args().text:
        draw()
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
