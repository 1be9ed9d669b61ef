"""Numerical experiments on fitted models: the behaviour of each effect, the names of the effects by this behaviour, and the
behaviour of the specimens in engineering quantities."""

# SciPy comes without types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from hsed_jax.behaviour.contributions import Contribution, contribution, dependence
from hsed_jax.behaviour.findings import QUANTITIES, SIDES, Behaviour, Behaviours, ProbedCurve, Value, told
from hsed_jax.behaviour.histories import PLACES, Imposition, Range, along_the_test, over_the_range
from hsed_jax.behaviour.names import PRACTICAL, Trait, called, trait
from hsed_jax.behaviour.probes import probed
from hsed_jax.behaviour.specimens import Answers, alone, answers, longest_step, spring_effects
from hsed_jax.diagnosis.evidence import Sampled
from hsed_jax.diagnosis.fits import Model, Set
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.physics.elements import Element
from hsed_jax.physics.names import by_owner, named, own_name, owner_of
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.simulator import Simulator

# Least number of simulated histories for an evaluation.
_ENOUGH = 8
# Number of posterior draws that are simulated.
_DRAWS = 24
# A driver is reported if it predicts this share of the differences between histories.
_TOLD = 0.1
# If these quantities do not change, the report states it.
_STEADY = ("initial_stiffness", "strength")
# A quantity that varies by more than this along the test is not said to stay: its change is uncertain, or that of the law.
_STAYS = 0.2
_OTHER_SIDE = str.maketrans("+-", "-+")

Drawn = Sequence[dict[str, float]]
"""Parameters of a model, by name, SI: the fit or draws of its posterior."""


@dataclass(frozen=True, eq=False)
class Probe:
    """Numerical experiments on the models of a problem.

    Attributes:
        problem: the problem of the diagnosis.
        simulator: its model with every candidate.
        visited: the range of the data.
    """

    problem: Problem
    simulator: Simulator
    visited: Range
    _traits: dict[tuple[str, Set, bytes], dict[str, Trait]] = field(default_factory=dict, init=False, repr=False)

    @property
    def is_component_test(self) -> bool:
        """Whether the data are from tests of a specimen alone, with an imposed elongation and without inputs to choose."""
        is_alone = self.simulator.structure is None and len(self.simulator.elements) == 1
        return is_alone and self.simulator.excitation is None and not self.problem.candidates

    @property
    def _largest_force(self) -> float:
        """The largest force of the fitted tests [N]; infinite if it is not measured, or if there are several specimens."""
        records = [one.record.channels for one in self.problem.experiments if one.record is not None]
        forces = [channels["force"] for channels in records if "force" in channels]
        if not forces or len(self.simulator.elements) > 1:
            return math.inf
        return max(float(np.nanmax(np.abs(force), initial=0.0)) for force in forces)

    def called(self, model: Model) -> Set:
        """The effects of a model, named by their behaviour; an effect whose behaviour has no name keeps its own name."""
        traits = self.traits(model)
        return frozenset(self.name(effect, traits) for effect in model.effects)

    def name(self, effect: str, traits: Mapping[str, Trait]) -> str:
        """The name of an effect by its behaviour, if the problem has an effect of this name; otherwise its own name."""
        instead = named(owner_of(effect), called(own_name(effect), traits.get(effect)))
        return instead if instead in self.problem.effects else effect

    def traits(self, model: Model) -> dict[str, Trait]:
        """The main behaviour of each effect of a model; effects whose behaviour has no name are omitted."""
        found: dict[str, Trait] = {}
        for element in self.simulator.elements:
            found |= self._traits_in(model, element)
        return found

    def behaviours(self, plain: Model, best: Model, sampled: Sampled, model_error: float) -> Behaviours:
        """The behaviour of the specimens in the best model, from the virgin specimen to the end of the test.

        Intervals hold the uncertainty of the parameters and the error of the model. The latter is the same along the whole test,
        so that it does not affect whether a quantity changes.

        Arguments:
            plain: the first model (without effects).
            best: the model with the named effects.
            sampled: sample of the posterior of the best model.
            model_error: standard deviation of the error of the best model, relative to the force.
        """
        changes: list[Behaviour] = []
        steady: dict[str, float] = {}
        curves: dict[str, ProbedCurve] = {}
        draws = self._drawn(best, sampled)
        random, largest = np.random.default_rng(self.problem.seed), self._largest_force
        for element in self.simulator.elements:
            before, after = self._along(plain, element, [self.fitted(plain)]), self._along(best, element, draws)
            law = self._along(best, element, [{**self.fitted(best), **self._without(self._effects(best, element))}])
            if before is None or after is None or law is None:
                continue
            strength = float(np.mean(np.abs(after["strength+"])))
            sizes = {"play": self.visited.elongation, "rate_force": strength}
            after = {
                name: values
                + model_error * _size(name, sizes, values.mean(axis=0)) * _normal(len(values), random)[:, None]
                for name, values in after.items()
            }
            for name, values in after.items():
                low, high = np.quantile(values, [0.05, 0.95], axis=0)
                curves[named(element.name, name)] = ProbedCurve(before[name][0], values.mean(axis=0), low, high)
            own = _both_sides(self._changed(after, law, sizes, element))
            drivers = self._drivers(best, element) if own else {}
            own = [replace(one, drivers=drivers.get(_read(one), {})) for one in own]
            errors = model_error * strength * _normal(_DRAWS // 2, random)
            own += self._added(best, element, draws[: _DRAWS // 2], errors)
            own += self._apart(law, after, ("recentring",) if own else _LASTING, element)
            changes += [replace(one, sentence=told(one, self.problem.pair, largest)) for one in own]
            moved = {q: _moved(after, q) for q in _STEADY if q not in {one.quantity for one in own}}
            steady |= {named(element.name, q): most for q, most in moved.items() if most <= _STAYS}
        return Behaviours(sorted(changes, key=_place), steady, curves, PLACES, self.problem.pair)

    def _along(self, model: Model, element: Element, draws: Drawn) -> dict[str, Float[np.ndarray, "S places"]] | None:
        """Quantities along the test, by draw; None if fewer than half of the draws can be simulated."""
        histories = along_the_test(self.visited, self.step(draws[0], element))
        specimen = self._specimen(model, element)
        found = answers(specimen, draws, histories.imposed)
        kept = np.flatnonzero(found.ok.all(axis=1))
        if len(kept) < 0.5 * len(draws):
            return None
        read = [probed(histories, found.force[k], found.ok[k]).quantities for k in kept]
        return {name: np.stack([one[name] for one in read]) for name in read[0] if name.rstrip("+-") in QUANTITIES}

    def _drivers(self, model: Model, element: Element) -> dict[str, dict[str, float]]:
        """The drivers of each quantity in the best fit over the range of the data, with their predictivity."""
        fit = self.fitted(model)
        histories = over_the_range(self.visited, self.step(fit, element), to_largest=True)
        found = answers(self._specimen(model, element), [fit], histories.imposed)
        if found.ok[0].sum() < _ENOUGH:
            return {}
        read = probed(histories, found.force[0], found.ok[0])
        by_name = {name: dependence(values, read.drivers) for name, values in read.quantities.items()}
        return {n: {d: round(s, 3) for d, s in shares.items() if s >= _TOLD} for n, shares in by_name.items()}

    def _changed(
        self,
        after: Mapping[str, np.ndarray],
        law: Mapping[str, np.ndarray],
        sizes: Mapping[str, float],
        element: Element,
    ) -> list[Behaviour]:
        """The quantities that change; arguments as of `_change`, by name of the quantity.

        One side of the loop is read after the other one, so both sides of a specimen change a little differently: if one changes,
        half as large a change of the other one is a change of both.
        """
        found = {name: self._change(name, after[name], law[name], sizes, element, PRACTICAL) for name in after}
        for name, one in found.copy().items():
            twin = name.translate(_OTHER_SIDE)
            if one is not None and found[twin] is None:
                other = self._change(twin, after[twin], law[twin], sizes, element, 0.5 * PRACTICAL)
                found[twin] = other if other is not None and other.change == one.change else None
        return [one for one in found.values() if one is not None]

    def _change(
        self,
        name: str,
        values: Float[np.ndarray, "S places"],
        law: Float[np.ndarray, "1 places"],
        sizes: Mapping[str, float],
        element: Element,
        least: float,
    ) -> Behaviour | None:
        """A quantity that changes from the virgin specimen to the end of the test; None if it hardly changes, or if the law
        alone changes it as much: a loop depends a little on the loops before it, without any effect.

        Arguments:
            name: of the quantity, with its side.
            values: by draw and position along the test.
            law: of the same specimen without its effects.
            sizes: reference sizes of some quantities, by name.
            element: the specimen.
            least: smallest relative change.
        """
        quantity, side = name.rstrip("+-"), name[-1]
        first, last = values[:, 0], values[:, -1]
        unit = QUANTITIES[quantity][1]
        low, high = np.quantile(last - first, [0.05, 0.95])
        change, of_law = (
            (ends[1] - ends[0]) / np.max(_size(name, sizes, ends))
            for ends in (values[:, [0, -1]].mean(axis=0), law[0, [0, -1]])
        )
        # The 90 % interval of the change is on one side of zero, and the mean change has a practical size.
        if not (low * high > 0 and min(np.sign(low) * change, np.sign(low) * (change - of_law)) > least):
            return None
        return Behaviour(
            quantity=quantity,
            change="grows" if low > 0 else "falls",
            drivers={},
            before=_value(first),
            after=_value(last),
            unit=self.problem.pair.unit(unit),
            sides=SIDES.get(side, "both"),
            specimen=element.name,
        )

    def _apart(
        self, law: Mapping[str, np.ndarray], after: Mapping[str, np.ndarray], names: Sequence[str], element: Element
    ) -> list[Behaviour]:
        """Those of some quantities that are constant along the test and differ clearly from those of the law alone, the largest
        difference first."""
        found: list[tuple[float, Behaviour]] = []
        for name in names:
            was, now, value = float(law[name].mean()), after[name].mean(axis=0), _value(after[name].mean(axis=1))
            quantity, unit = name.rstrip("+-"), QUANTITIES[name.rstrip("+-")][1]
            scale = 1.0 if unit == "1" else max(abs(was), abs(value.mean))
            apart, is_constant = abs(value.mean - was) / scale, np.ptp(now) <= PRACTICAL * scale
            if apart > PRACTICAL and is_constant and not value.q05 <= was <= value.q95:
                constant, unit = Value(was, was, was), self.problem.pair.unit(unit)
                found.append((apart, Behaviour(quantity, "differs", {}, constant, value, unit, specimen=element.name)))
        return [one for _, one in sorted(found, key=lambda one: -one[0])]

    def _added(self, model: Model, element: Element, draws: Drawn, errors: Float[np.ndarray, " S"]) -> list[Behaviour]:
        """Forces that effects add and that depend on the elongation alone or on the rate alone, where the interval shows them.

        Arguments:
            model: with the effects.
            element: the specimen.
            draws: parameters of the model.
            errors: added to the forces of the draws [N].
        """
        mains = self._traits_in(model, element)
        adding = [effect for effect, main in mains.items() if main.quantity in ("elastic_force", "rate_force")]
        found: list[Behaviour] = []
        for effect, own in self._contributions(model, element, draws, adding).items():
            main = mains[effect]
            curves = [one.elastic if main.quantity == "elastic_force" else one.by_rate for one in own]
            least = np.asarray([curve.force[np.argmin(np.abs(curve.at))] for curve in curves])
            most = np.asarray([curve.force[-1] for curve in curves]) + errors[: len(curves)]
            is_friction = main.quantity == "rate_force" and main.change == "steady"
            low, high = np.quantile(most if is_friction else most - least, [0.05, 0.95])
            if not low * high > 0:
                continue
            change = "is there" if main.change == "steady" else "falls" if main.change == "falls" else "grows"
            best = curves[0].share
            found.append(
                Behaviour(
                    quantity=main.quantity,
                    change=change,
                    drivers={main.driver: round(best, 3)},
                    before=_value(most if is_friction else least),
                    after=_value(most),
                    unit=self.problem.pair.unit("N"),
                    specimen=element.name,
                )
            )
        return found

    def _traits_in(self, model: Model, element: Element) -> dict[str, Trait]:
        """The main behaviour of each effect of a model in a specimen; simulated once for each fit."""
        fit = element.name, model.effects, self.problem.models.theta(model.fit.x, model.fit.submodel).tobytes()
        if fit not in self._traits:
            own = [effect for effect in self._effects(model, element) if effect in model.effects]
            found = self._contributions(model, element, [self.fitted(model)], own)
            self._traits[fit] = {e: main for e, (own, *_) in found.items() if (main := trait(own)) is not None}
        return self._traits[fit]

    def _contributions(
        self, model: Model, element: Element, draws: Drawn, own: Sequence[str]
    ) -> dict[str, list[Contribution]]:
        """The influence of effects of a model in a specimen, by effect and draw."""
        if not own:
            return {}
        histories = over_the_range(self.visited, self.step(draws[0], element))
        models = [{**draw, **absent} for draw in draws for absent in ({}, *(self._without([one]) for one in own))]
        answered = answers(self._specimen(model, element), models, histories.imposed)
        each = enumerate(zip(answered.force, answered.ok, strict=True))
        read = {number: probed(histories, force, ok) for number, (force, ok) in each if ok.any()}
        found: dict[str, list[Contribution]] = {}
        for first in range(0, len(models), 1 + len(own)):
            for number, effect in enumerate(own, start=first + 1):
                pair = [first, number]
                if answered.ok[pair].all(axis=0).sum() >= _ENOUGH:
                    both = read[first], read[number]
                    one = contribution(histories, answered.force[pair], both, self.visited.rate)
                    found.setdefault(effect, []).append(one)
        return found

    def forces(self, model: Model, thetas: Sequence[np.ndarray], element: Element, histories: Imposition) -> Answers:
        """The forces of a specimen under imposed histories, with the effects of a model and several θ, (P,) each."""
        return answers(self._specimen(model, element), [self._named(model, theta) for theta in thetas], histories)

    def step(self, parameters: Mapping[str, float], element: Element) -> float:
        """The longest change of the elongation in a step of the simulation of a specimen [m]."""
        known = {**dict(self.simulator.constants), **parameters}
        law = element.law(**element.parameters(by_owner(known)))
        return longest_step(float(law.yield_elongation), self.visited.elongation)

    # Models as specimens.

    def _effects(self, model: Model, element: Element) -> list[str]:
        """The effects of a specimen in a model: those of the study, and the named ones."""
        return [effect for effect in spring_effects(self.simulator, element) if self._has(model, effect)]

    def _specimen(self, model: Model, element: Element) -> Simulator:
        """The specimen with the effects of a model, in their forms."""
        own = self._effects(model, element)
        free = {self.problem.names[int(k)] for k in model.fit.free}
        fitted = self.fitted(model)
        held = {name: value for name, value in fitted.items() if owner_of(name) in own and name not in free}
        lean = replace(self.simulator, effects=self.simulator.effects.only(own))
        return alone(lean, element, held)

    def fitted(self, model: Model) -> dict[str, float]:
        """Parameters of the law and of the effects of a model at its best fit, by name, SI."""
        return self._named(model, self.problem.models.theta(model.fit.x, model.fit.submodel))

    def _drawn(self, model: Model, sampled: Sampled) -> Drawn:
        """Draws of equal weight from a weighted sample."""
        shares = (np.arange(_DRAWS) + 0.5) / _DRAWS
        rows = np.searchsorted(np.cumsum(sampled.weights) / np.sum(sampled.weights), shares)
        return [self._named(model, sampled.thetas[min(k, len(sampled.thetas) - 1)]) for k in rows]

    def _named(self, model: Model, theta: np.ndarray) -> dict[str, float]:
        """Parameters of the law and of the effects of a model, by name."""
        return {n: float(v) for n, v in zip(self.problem.names, theta, strict=True) if self._has(model, owner_of(n))}

    def _has(self, model: Model, owner: str) -> bool:
        """Whether an effect is in a model: candidates are if the model names them."""
        return owner in model.effects or owner not in self.problem.effects

    def _without(self, effects: Sequence[str]) -> dict[str, float]:
        """The amplitudes of effects at their neutral values, at which the effects are absent."""
        amplitudes = {e: next(iter(parameters_of(self.simulator.effects[e]).values())) for e in effects}
        return {f"{e}.{one.name}": one.neutral for e, one in amplitudes.items() if one.neutral is not None}


# These quantities are compared with those of the law alone if nothing changes along the test; the recentring always is.
_LASTING = ("recentring", "initial_stiffness", "strength+", "pinching_ratio", "sharpness")


def _size(name: str, sizes: Mapping[str, float], values: Float[np.ndarray, " places"]) -> np.ndarray:
    """The values that a relative error of a quantity refers to: those of `sizes`; otherwise one for a ratio, else its own."""
    quantity = name.rstrip("+-")
    own = np.ones(len(values)) if QUANTITIES[quantity][1] == "1" else np.abs(values)
    return np.full(len(values), sizes[quantity]) if quantity in sizes else own


def _normal(count: int, random: np.random.Generator) -> Float[np.ndarray, " S"]:
    """Quantiles of the standard normal distribution in random order: draws without sampling error."""
    return random.permutation(ndtri((np.arange(count) + 0.5) / count))


def _value(values: np.ndarray) -> Value:
    low, high = np.quantile(values, [0.05, 0.95])
    return Value(float(values.mean()), float(low), float(high))


def _read(one: Behaviour) -> str:
    """The name under which a quantity was evaluated, with its side."""
    signs = {side: sign for sign, side in SIDES.items()}
    has_sides = one.quantity in ("strength", "unloading_stiffness")
    return one.quantity + (signs.get(one.sides, "+") if has_sides else "")


def _both_sides(changes: Sequence[Behaviour]) -> list[Behaviour]:
    """Changes; if both sides have the same change, only the one in tension is kept, for both sides."""
    twins = {(one.quantity, one.change) for one in changes if one.sides == "compression"}
    alike = {(one.quantity, one.change) for one in changes if one.sides == "tension"} & twins
    return [
        replace(one, sides="both") if (one.quantity, one.change) in alike else one
        for one in changes
        if not (one.sides == "compression" and (one.quantity, one.change) in alike)
    ]


def _place(one: Behaviour) -> int:
    """The position of a change in the report: changes have the order of the quantities."""
    return [*QUANTITIES].index(one.quantity)


def _moved(values: Mapping[str, np.ndarray], quantity: str) -> float:
    """The largest relative change of a quantity along the test."""
    means = [v.mean(axis=0) for name, v in values.items() if name.rstrip("+-") == quantity]
    return max(float(np.ptp(mean) / max(np.abs(mean).max(), 1e-300)) for mean in means)
