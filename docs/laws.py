"""Writes `docs/laws.md`: the spring laws, their equations and parameters, from the code alone."""

import inspect
import math
from collections.abc import Mapping
from pathlib import Path

from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.laws import LAWS
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.physics.specimen import ALWAYS, unserved

PAGE = Path(__file__).parent / "laws.md"

HEAD = r"""# Spring laws

*Written by `python docs/laws.py` from the code; not to be edited by hand.*

The law of the specimen is chosen by `model.spring`; a virtual specimen may have another one, `experiments.virtual.spring`. All
of them stand behind one seam (`hsed_jax/physics/laws/base.py`): an element with a force f, effects around it
(`hsed_jax/physics/specimen.py`),

$$r = f(\Delta u, \text{states}) + \sum \text{force},\qquad \dot e = r\,\Delta\dot u.$$

**Two kinds.** Bouc–Wen integrates its force, ż = g Δu̇. The others know their force as a continuous function of the elongation,
given the states that were committed at the end of the last step, as materials of finite element programs do; where the
elongation turns within a step, the states are committed at the turn. On cyclic paths the latter are those of OpenSees to all
digits (`tests/data/laws.csv`: Steel01, Steel02, Hysteretic); an oscillator with 40 steps to its period has peaks and work within
3e-4 of a central-difference solution with 4000. Corners of a law (yielding, zero force) are not looked for within a step.

**Which effects.** Effects write to [places in a law](effects.md), and a law has some of them: all have `force` (what acts
beside the element) and `slack`. An effect whose place the law lacks is refused in a study; a diagnosis does not look for it,
and says so.

**Parameters** that have a default may be left out; a value, a prior, or `{}` for the prior of the table stand for them in
`model.parameters`.

| law | what it is | effects it cannot have |
|---|---|---|
"""

OWN = r"""
## A law of your own

`model: {spring: mine.py:Cubic}`, the file relative to the study, takes a class of your own
([when the file is executed](laboratories.md#what-is-executed-when)). It is an equinox module with parameters as fields; `force`
must be continuous in the elongation, and both sides of a `jnp.where` finite, for derivatives pass through them.

```python
from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.parameters import parameter


@final
class Cubic(AbstractSpringLaw):
    r"A spring that stiffens: $k\,\Delta u\,(1 + (\Delta u/u_c)^2)$."

    name: ClassVar[str] = "cubic"
    title: ClassVar[str] = "a spring that stiffens"
    reference: ClassVar[str] = "Duffing 1918"
    steepest: ClassVar[dict[str, float]] = {"k": 0.999}  # the quantile of its prior at which the law is stiffest

    k: float = parameter("k", "N/m", "stiffness at rest", lower=0.0)
    u_c: float = parameter("u_c", "m", "elongation at which the stiffness has doubled", lower=1e-6)

    @property
    def stiffness(self):
        return self.k

    @property
    def strength(self):
        return jnp.inf  # it never yields

    def start(self):
        return {"hysteretic": jnp.zeros(())}

    def force(self, elongation, memory, slots):
        return self.k * elongation * (1 + (elongation / self.u_c) ** 2)

    def settle(self, elongation, memory, slots):
        return {"hysteretic": self.force(elongation, memory, slots)}
```

A law that remembers declares its states in `start` and commits them in `settle` (`hsed_jax/physics/laws/bilinear.py` is the
shortest example); one that integrates its force has `flow` instead, and mends the kink at a reversal in `mended`
(`hsed_jax/physics/laws/reversal.py` with its derivation, also in [the equations](equations.md#the-kink-at-a-reversal)).
"""


def page() -> str:
    """The text of `docs/laws.md`."""
    index, parts = [], []
    for name, law in LAWS.items():
        lacking = [
            f"`{effect}`"
            for effect, kind in EFFECTS.items()
            if unserved(kind, law) and not getattr(kind, "linear_only", False)
        ]
        index.append(f"| [`{name}`](#{name}) | {law.title} | {', '.join(lacking) or 'none'} |")
        rows = [_row(known) for known in parameters_of(law).values()]
        places = ", ".join(f"`{slot}`" for slot in (*ALWAYS, *law.slots))
        parts += [
            f"\n## {name}\n",
            inspect.cleandoc(law.__doc__ or ""),
            "",
            "| parameter | symbol | unit | meaning | default | range | prior |",
            "|---|---|---|---|---|---|---|",
            *rows,
            "",
            f"Places for effects: {places}. Reference: {law.reference}.",
        ]
    text = HEAD + "\n".join([*index, *parts]) + "\n" + OWN
    return text.replace("\\,", "\\thinspace ").replace("\\!", "\\negthinspace ")


def _row(known: Parameter) -> str:
    low, high = (f"{bound:g}" if math.isfinite(bound) else "∞" for bound in (known.lower, known.upper))
    bounds = "any" if low == "∞" else f"{low} to {high}"
    default = "required" if known.neutral is None else f"{known.neutral:g}"
    prior = ", ".join(f"`{kind}` {_arguments(given)}" for kind, given in (known.prior or {}).items()) or "–"
    cells = (f"`{known.name}`", f"${known.symbol}$", known.unit, known.meaning, default, bounds, prior)
    return f"| {' | '.join(cells)} |"


def _arguments(given: object) -> str:
    if isinstance(given, Mapping):
        return ", ".join(f"{key} {value:g}" for key, value in given.items())
    return ", ".join(f"{value:g}" for value in given) if isinstance(given, list | tuple) else f"{given:g}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
