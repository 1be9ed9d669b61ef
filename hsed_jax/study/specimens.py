"""The specimens of a study: their laws, and the parameters of the model and of a virtual specimen by their names.

With several specimens, the name of a specimen precedes its parameters: `storey2.A`, `storey2.slip.delta`.  A parameter
without this name is shared by all specimens without their own model.  A linear spring has one effect in the catalogue, which
makes it yield: `spring_1.yielding`.
"""

import difflib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.effects.base import Form
from hsed_jax.physics.effects.forms import forms_of
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws import AbstractSpringLaw, Elastic
from hsed_jax.physics.names import OWNER, by_owner, named, number_of_spring, own_name, owner_of
from hsed_jax.physics.pairs import Pair
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.physics.specimen import unserved
from hsed_jax.physics.structures import parameter_of
from hsed_jax.plain import shown
from hsed_jax.sections import DRIVER, FORM
from hsed_jax.study.elements import is_of_linear, is_of_specimen
from hsed_jax.study.parts import check_names, prior, within


@dataclass(frozen=True)
class Naming:
    """The meaning of the names in a study.

    Attributes:
        elements: the specimens.
        catalogue: the effects that may be named.
    """

    elements: tuple[Element, ...]
    catalogue: Catalogue

    def laws_with(self, effect: str) -> list[type[AbstractSpringLaw]]:
        """The laws that may have an effect in a spring."""
        owner = owner_of(effect)
        if number_of_spring(owner) is not None:
            return [Elastic]
        return [element.law for element in self.elements if element.has(owner)]

    def unserved(self, effect: str, form: str | None = None) -> str:
        """The reason why the specimens cannot have an effect, in one of its forms or in its default form; empty if they can."""
        kind = self.catalogue[effect]
        return next((why for law in self.laws_with(effect) if (why := unserved(kind, law, form))), "")

    def forms(self, effect: str) -> dict[str, Form]:
        """The forms that an effect can have, by their labels."""
        known = forms_of(self.catalogue[effect])
        return {label: form for label, form in known.items() if not self.unserved(effect, label)}

    def form(self, where: str, effect: str, entries: Mapping[str, Any]) -> Form:
        """The form in which an effect is given.

        Raises:
            UserError: it has no such form or driver, or the law cannot have it.
        """
        kind = self.catalogue[effect]
        shapes, drivers = [shape.name for shape in kind.forms], list(kind.drivers)
        shape = entries.get(FORM, shapes[0] if shapes else "")
        driver = entries.get(DRIVER, drivers[0] if drivers else "")
        for key, word, allowed in ((FORM, shape, shapes), (DRIVER, driver, drivers)):
            if key in entries and word not in allowed:
                having = f"it has {', '.join(allowed)}" if allowed else f"it has no choice of a {key}"
                raise UserError(f"{where}.{effect}.{key}: there is no {key} {shown(word)} of {effect}; {having}")
        label = Form(shape, driver="" if not drivers or driver == drivers[0] else driver).label
        known = forms_of(kind)
        if label not in known:
            able = [one.name for one in known.values() if one.driver == driver]
            raise UserError(
                f"{where}.{effect}.{FORM}: {effect} of {driver} has no form {shown(shape)}, as its driver has powers of its own; "
                f"it has {', '.join(able)}"
            )
        if missing := self.unserved(effect, label):
            raise UserError(f"{where}.{effect}: {missing}")
        return known[label]

    @property
    def candidates(self) -> list[str]:
        """Effects that a diagnosis may look for: those of each named specimen, and those of all specimens."""
        have_names = any(element.name for element in self.elements)

        def is_one(name: str) -> bool:
            effect, owner = self.catalogue[name], owner_of(name)
            if number_of_spring(owner) is None and is_of_linear(effect) and Elastic not in self.laws_with(name):
                return False
            return bool(owner) or not (have_names and is_of_specimen(effect))

        return [name for name in self.catalogue if is_one(name)]

    def left_out(self) -> list[str]:
        """The effects that a diagnosis leaves out because of the laws, in a sentence; empty if there are none."""
        by_law: dict[str, list[str]] = defaultdict(list)
        for name in self.candidates:
            if self.unserved(name):
                by_law[self.laws_with(name)[0].name].append(name)
        return [
            f"not considered, because the law {law} has no place for them: {', '.join(names)}"
            for law, names in by_law.items()
        ]

    def parameters(self, effect: str, form: Form) -> dict[str, Parameter]:
        """Parameters of an effect in a form under both their names, the dimensionless and the physical one."""
        kind = self.catalogue[effect]
        return {**form.parameters(kind), **form.physical(kind)}

    @cached_property
    def of_laws(self) -> dict[str, Parameter]:
        """The parameters of the laws, by name: shared ones, and those that each of several specimens has or may have alone."""
        shared = {
            name: known
            for element in self.elements
            if not element.is_apart
            for name, known in parameters_of(element.law).items()
        }
        own = {
            named(element.name, name): known
            for element in self.elements
            if element.name
            for name, known in parameters_of(element.law).items()
        }
        return shared | own

    def known(self, name: str) -> Parameter | None:
        """The declaration of a parameter of a law, of an effect under either of its names, or of the structure; else None."""
        owner, own = owner_of(name), own_name(name)
        if owner == OWNER:
            return parameter_of(own)
        if name in self.of_laws:
            return self.of_laws[name]
        effect = self.catalogue.get(owner)
        every = () if effect is None else parameters_of(effect).values()
        return next((p for p in every if own in (p.name, p.physical.name if p.physical else "")), None)

    def units(self, names: Sequence[str], constants: Mapping[str, float], pair: Pair) -> dict[str, str]:
        """SI unit of every named parameter of specimens that are measured in a pair."""
        units: dict[str, str] = {}
        for name in names:
            owner, own = owner_of(name), own_name(name)
            if owner == OWNER:
                unit = parameter_of(own).unit
            elif name in self.of_laws:
                unit = self.of_laws[name].unit
            else:
                known = parameters_of(self.catalogue[owner])
                physical = {p.physical.name: p.physical.unit for p in known.values() if p.physical is not None}
                unit = known[own].unit if own in known else physical[own]
            exponent = named(owner, "n") if named(owner, "n") in {**constants, **dict.fromkeys(names)} else "n"
            # With n = 1, β and γ have an ordinary unit.
            is_plain = constants.get(exponent, 1.0) == 1 and exponent not in names
            unit = "1/m" if unit == "N^(1-n)/m" and is_plain else unit
            units[name] = unit if owner == OWNER else pair.unit(unit)
        return units

    def laws(
        self, parameters: tuple[Mapping[str, Prior], Mapping[str, float]], *, steepest: bool = False
    ) -> tuple[AbstractSpringLaw, ...]:
        """The laws of the specimens in the middle of the priors, or at the parameters where they are stiff and yield early.

        Arguments:
            parameters: free ones of the model with their priors, and fixed ones.
            steepest: which of the two.
        """
        return tuple(
            element.law(
                **element.parameters(by_owner(self.middle(parameters, element.law.steepest if steepest else {})))
            )
            for element in self.elements
        )

    def middle(
        self, parameters: tuple[Mapping[str, Prior], Mapping[str, float]], quantiles: Mapping[str, float] | None = None
    ) -> dict[str, float]:
        """Parameters of the laws in the middle of their priors, or at quantiles by their own names; fixed ones as they are."""
        free, fixed = parameters
        found = {
            name: float(prior.quantile((quantiles or {}).get(own_name(name), 0.5)))
            for name, prior in free.items()
            if name in self.of_laws
        }
        return found | {name: value for name, value in fixed.items() if name in self.of_laws}

    def model_parameters(
        self, study: Study, of_structure: Mapping[str, Prior], pair: Pair, open_forms: Sequence[str] = ()
    ) -> tuple[dict[str, Prior], dict[str, float]]:
        """Free parameters of the model with their priors, those of the structure last, and the fixed ones with their values.

        Arguments:
            study: the study.
            of_structure: parameters of the structure.
            pair: that the specimens are measured in.
            open_forms: effects with free parameters of their forms.

        Raises:
            UserError: a name that stands for nothing, a value that cannot be, or one that is missing.
        """
        free: dict[str, Prior] = {}
        fixed: dict[str, float] = {}
        for name, (where, known, entry) in self._given(study, pair, open_forms).items():
            if entry == {}:
                if known.prior is None:
                    raise UserError(
                        f"{where}: there is no default prior for it; give one, such as {{uniform: [1.0, 2.0]}}"
                    )
                where, entry = "", dict(known.prior)
            if isinstance(entry, dict):
                free[name] = prior(where, cast("dict[str, Any]", entry))
                # Priors of the catalogue need no check; a lognormal one reaches down to a bound of 0.01, with no mass there.
                for bound in free[name].bounds if where else ():
                    if bound is not None:
                        within(where, bound, known)
            else:
                fixed[name] = within(where, float(entry), known)
        free |= of_structure
        if not free:
            first = next(iter(self.of_laws))
            raise UserError(
                f"model.parameters: at least one parameter needs a prior, such as {first}: {{uniform: [2.0e5, 9.0e5]}}"
            )
        return free, fixed

    def _given(self, study: Study, pair: Pair, open_forms: Sequence[str]) -> dict[str, tuple[str, Parameter, Any]]:
        """All entries of the model, given or default, by name: place, declaration, value."""
        said = {name: (f"model.parameters.{name}", entry) for name, entry in study.model.parameters.items()}
        check_names("model.parameters", study.model.parameters, self._sayable)
        for element in self.elements:
            where, own = own_model(study, element)
            if own is not None:
                check_names(f"{where}.parameters", own.parameters, parameters_of(element.law))
                said |= {named(element.name, n): (f"{where}.parameters.{n}", e) for n, e in own.parameters.items()}
        self._check_complete(said, study, pair)
        given = {name: (*said[name][:1], known, said[name][1]) for name, known in self.of_laws.items() if name in said}
        for effect, (where, entries) in effects_of(study).items():
            form, allowed = self.checked_effect(where, effect, entries)
            held: Mapping[str, float] = {} if effect in open_forms else form.held
            values = {name: entry for name, entry in entries.items() if name not in (FORM, DRIVER)}
            taken = {allowed[name].name for name in values}
            for name, entry in values.items():
                given[f"{effect}.{name}"] = (f"{where}.{effect}.{name}", allowed[name], entry)
            every = parameters_of(self.catalogue[effect])
            free = self._of_forms(effect) if effect in open_forms else form.parameters(self.catalogue[effect])
            for name in free:
                if name not in taken:
                    given[f"{effect}.{name}"] = ("", every[name], dict(every[name].prior or {}))
            for name, value in held.items():
                given[f"{effect}.{name}"] = ("", every[name], value)
        return given

    def _of_forms(self, effect: str) -> list[str]:
        """The parameters of an effect that are free or fixed in any of its possible forms."""
        forms, known = self.forms(effect).values(), parameters_of(self.catalogue[effect])
        told = {name for form in forms for name in (*form.free, *form.held)}
        return [name for name, parameter in known.items() if name in told or not parameter.shapes]

    @property
    def _sayable(self) -> dict[str, Parameter]:
        apart = [element.name for element in self.elements if element.is_apart]
        return {name: known for name, known in self.of_laws.items() if owner_of(name) not in apart}

    def _check_complete(self, said: Mapping[str, Any], study: Study, pair: Pair) -> None:
        for element in self.elements:
            where, _ = own_model(study, element)
            for name, known in parameters_of(element.law).items():
                is_said = named(element.name, name) in said or (not element.is_apart and name in said)
                if known.neutral is None and not is_said:
                    meaning = f"{pair.words(known.meaning)}, {pair.unit(known.unit)}"
                    raise UserError(f"{where}.parameters.{name}: this key is required ({meaning})")

    def true_parameters(self, study: Study) -> dict[str, float]:
        """The parameters of a virtual specimen, or of each of several.

        Raises:
            UserError: a name that stands for nothing, a value that cannot be, or one that is missing.
        """
        entry, where = study.experiments.specimen, "experiments.virtual"
        assert entry is not None
        check_names(f"{where}.parameters", entry.parameters, self.of_laws)
        truth = {
            name: within(f"{where}.parameters.{name}", value, self.of_laws[name])
            for name, value in entry.parameters.items()
        }
        for element in self.elements:
            for name, known in parameters_of(element.law).items():
                own = named(element.name, name)
                if known.neutral is None and own not in truth and (element.is_apart or name not in truth):
                    missing = own if element.is_apart else name
                    raise UserError(f"{where}.parameters.{missing}: this key is required ({known.meaning})")
        for effect, values in entry.effects.items():
            form, allowed = self.checked_effect(f"{where}.effects", effect, values)
            truth |= {f"{effect}.{name}": value for name, value in form.held.items()}
            for name, value in values.items():
                if name not in (FORM, DRIVER):
                    truth[f"{effect}.{name}"] = within(f"{where}.effects.{effect}.{name}", value, allowed[name])
        return truth

    def checked_effect(self, where: str, effect: str, entries: Mapping[str, Any]) -> tuple[Form, dict[str, Parameter]]:
        """The form of an effect, and its parameters under both their names.

        Raises:
            UserError: there is no such effect or parameter, or the law cannot have the effect.
        """
        if effect not in self.catalogue:
            raise UserError(f"{where}.{effect}: {self.no_such(effect)}")
        form = self.form(where, effect, entries)
        if is_of_specimen(self.catalogue[effect]) and not self.laws_with(effect):
            each = ", ".join(named(element.name, effect) for element in self.elements)
            raise UserError(f"{where}.{effect}: no specimen shares the model of the study; name the specimen, {each}")
        allowed = self.parameters(effect, form)
        names = [name for name in entries if name not in (FORM, DRIVER)]
        check_names(f"{where}.{effect}", dict.fromkeys(names), allowed)
        for name in names:
            same = [other for other in names if allowed[other].name == allowed[name].name]
            if len(same) > 1:
                raise UserError(
                    f"{where}.{effect}: {' and '.join(same)} are two forms of one parameter; give one of them"
                )
        return form, allowed

    def no_such(self, effect: str) -> str:
        """The message that there is no such effect, with the existing ones."""
        close = difflib.get_close_matches(effect, self.catalogue, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        return f"there is no such effect{hint}; the catalogue has {', '.join(self.catalogue)}"


def own_model(study: Study, element: Element) -> tuple[str, Any]:
    """The key of the model of a specimen, and the entry if it has its own model."""
    if not element.is_apart:
        return "model", None
    assert study.structure is not None
    assert study.structure.specimens is not None
    return f"structure.specimens.{element.name}.model", study.structure.specimens[element.name].model


def effects_of(study: Study) -> dict[str, tuple[str, Mapping[str, Any]]]:
    """The effects of the model; those of a specimen's own model have its name. Each has its key and its entry.

    Raises:
        UserError: one is given twice.
    """
    found: dict[str, tuple[str, Mapping[str, Any]]]
    found = {name: ("model.effects", entries) for name, entries in study.model.effects.items()}
    for where, name, entries in _of_own_models(study):
        if name in found:
            raise UserError(f"model.effects.{name}: {where} gives it, too; leave one of them out")
        found[name] = (where, entries)
    return found


def _of_own_models(study: Study) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    several = {} if study.structure is None else study.structure.specimens or {}
    for specimen, entry in several.items():
        if entry.model is not None:
            for name, entries in entry.model.effects.items():
                yield f"structure.specimens.{specimen}.model.effects", named(specimen, name), entries
