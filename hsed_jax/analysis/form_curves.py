"""The shapes of the forms of an effect: the contribution of each, over the variable that distinguishes them."""

from collections import defaultdict
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.priors import Prior
from hsed_jax.physics.effects.base import MULTIPLIED, AbstractSpringEffect, Form, SpringPoint
from hsed_jax.physics.effects.bristles import AbstractBristledEffect
from hsed_jax.physics.parameters import Parameter
from hsed_jax.physics.scales import Scalar, Scales

_PLACES = 48
# Values of the variables that are not swept: within the range of the drivers, and not zero, because no force has a
# shape there.
_RESTING = {"elongation": 0.1, "rate": 0.5, "force": 0.5, "driver": 0.5}
_ACROSS = {
    "driver": "its driver x, from 0 to 1",
    "elongation": "the elongation, from −u_c to u_c",
    "rate": "the rate of elongation, from −v_c to v_c",
    "force": "the force of the element, from −F_c to F_c",
}
_AMPLITUDE = 0.5
# Losses after a long path happen within the picture.
_LIFE = {"life": 0.5}


class Curves(NamedTuple):
    """The contributions of the forms of an effect.

    Attributes:
        what: meaning of the values, in words.
        across: the variable that distinguishes them, in words, with its range.
        places: along it, over the characteristic value, (n,).
        values: by the name of the form: the sum of its addends and of its factors minus one; for an effect with its own
            states, their rates, (n,).
    """

    what: str
    across: str
    places: Float[np.ndarray, " n"]
    values: dict[str, Float[np.ndarray, " n"]]


def curves_of(effect: type[AbstractSpringEffect]) -> Curves:
    """The contributions of the forms of a spring's effect, all characteristic values being one.

    The amplitude is one half. Shape parameters that a form frees are one standard deviation of their priors from the middle.
    The swept variable is elongation, rate, force or driver: the one with the fewest equal forms, and of these the one with
    the largest differences.

    Raises:
        ValueError: the effect has no forms.
    """
    if not effect.forms:
        raise ValueError(f"{effect.name} has one formula and no forms")
    places = {name: np.linspace(0.0 if name == "driver" else -1.0, 1.0, _PLACES) for name in _ACROSS}
    # All sweeps in a row, so that each form is evaluated once.
    at = {
        key: jnp.asarray(np.concatenate([places[name] if name == key else np.full(_PLACES, rest) for name in _ACROSS]))
        for key, rest in _RESTING.items()
    }
    contributed = {form.name: _contributed(effect, form, at).reshape(len(_ACROSS), -1) for form in effect.forms}
    swept = {name: {form: rows[i] for form, rows in contributed.items()} for i, name in enumerate(_ACROSS)}
    name = max(swept, key=lambda key: _apart(swept[key]))
    flows = effect.flow is not AbstractSpringEffect.flow
    what = "rate of its own state" if flows else "contribution of each form"
    return Curves(what, _ACROSS[name], places[name], swept[name])


def _contributed(
    effect: type[AbstractSpringEffect], form: Form, at: dict[str, Float[Array, " n"]]
) -> Float[np.ndarray, " n"]:
    known = form.parameters(effect)
    first = next(iter(known))
    freed = {key: _away(p) for key, p in known.items() if p.shapes}
    shown = {key: value for key, value in _LIFE.items() if key in known}
    made = effect(**{first: _AMPLITUDE, **shown, **freed, **form.held})

    def total(at: dict[str, Float[Array, ""]]) -> Float[Array, ""]:
        # Every driver of its history has this value.
        memory: dict[str, Scalar] = defaultdict(lambda: at["driver"])
        point = SpringPoint(at["elongation"], at["rate"], at["force"], memory, Scales(1.0, 1.0, 1.0, 1.0), 1.0, 1.0)
        if isinstance(made, AbstractBristledEffect) and made.states:
            # A bristle slides beyond a quarter of the characteristic elongation.
            bent = jnp.sign(at["rate"]) * made.slides_at(point) * jnp.clip(4 * at["elongation"], -1.0, 1.0)
            memory |= dict(zip(made.states, (bent, made.foot(point)), strict=True))
        if rates := made.flow(point):
            return jnp.asarray(sum(rates.values()))
        return jnp.asarray(sum(value - (slot in MULTIPLIED) for slot, value in made.contribute(point).items()))

    return np.asarray(jax.vmap(total)(at))


def _away(known: Parameter) -> float:
    """A value of a shape parameter that shows its influence: one standard deviation of its prior towards the side that
    is further from the default form.
    """
    neutral = known.neutral
    assert neutral is not None
    if not known.prior:
        return neutral
    prior = Prior(*next(iter(known.prior.items())))
    return max((float(prior.quantile(share)) for share in (0.16, 0.84)), key=lambda value: abs(value - neutral))


def _apart(values: dict[str, Float[np.ndarray, " n"]]) -> tuple[int, float]:
    """The number of forms with a shape, and their distances from one another, each over its own range."""
    ranges = [float(np.ptp(v)) for v in values.values()]
    shapes = np.stack([(v - v.min()) / max(size, 1e-12) for v, size in zip(values.values(), ranges, strict=True)])
    return sum(size > 1e-9 for size in ranges), float(np.sum(np.var(shapes, axis=0)))
