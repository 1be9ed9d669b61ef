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

`model.spring` chooses the law of the specimen. A virtual specimen may have another law, `experiments.virtual.spring`. A law
is an element with a force f (`hsed_jax/physics/laws/base.py`). The specimen adds the effects
(`hsed_jax/physics/specimen.py`):

$$r = f(\Delta u, \text{states}) + \sum \text{force},\qquad \dot e = r\,\Delta\dot u.$$

**Two kinds.** Bouc–Wen integrates its force, ż = g Δu̇. The force of the other laws is a continuous function of the
elongation, given the states that were committed at the end of the last step, as in finite-element programs. Where the
elongation reverses within a step, the states are committed at the reversal. On cyclic paths these laws agree with OpenSees
to all digits (`tests/data/laws.csv`: Steel01, Steel02, Hysteretic). An oscillator with 40 steps per period has peaks and
work within 3e-4 of a central-difference solution with 4000. The step is not split at corners of a law (yielding, zero
force).

**Which effects.** Effects write to [slots of a law](effects.md). All laws have the slots `force` (a force parallel to
the element) and `slack`. If a law lacks the slot of an effect, a study with this effect is refused. A diagnosis leaves
the effect out and reports this.

**Parameters** with a default may be left out. `model.parameters` takes a value, a prior, or `{}` for the prior of the table.

| law | what it is | effects it cannot have |
|---|---|---|
"""

OWN = r"""
## A law of your own

`model: {spring: mine.py:Cubic}` uses your class; the file is relative to the study
([execution of code](laboratories.md#execution-of-code)). The class is an equinox module with the parameters as fields.
`force` must be continuous in the elongation. Both sides of a `jnp.where` must be finite, because derivatives pass
through them.

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

A law with memory declares its states in `start` and commits them in `settle`; the shortest example is
`hsed_jax/physics/laws/bilinear.py`. A law that integrates its force has `flow` instead, and corrects the [kink at a
reversal](equations.md#the-kink-at-a-reversal) in `mended` (`hsed_jax/physics/laws/reversal.py`).
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
            f"Slots for effects: {places}. Reference: {law.reference}.",
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
