"""The question of a study in sentences, from the study file in the run folder."""

from collections.abc import Mapping
from typing import Any

from hsed_jax.laboratories.kinds import KINDS
from hsed_jax.measurements import Campaign
from hsed_jax.physics.declared import DECLARED
from hsed_jax.physics.laws import LAWS
from hsed_jax.physics.outputs import driven_mass
from hsed_jax.reporting.page_tables import unit_words

_RELATIVE_TO = {
    ("quantities", "predicted"): "each predicted value (log-normal)",
    ("quantities", "measured"): "each measured value (Gaussian)",
    ("histories", "predicted"): "the RMS of each history",
    ("histories", "measured"): "the RMS of each history",
}


def asked(study: Mapping[str, Any], campaign: Campaign) -> list[str]:
    """Sentences on specimen, excitation, model, experiments, observed outputs, their error, and the steps."""
    parts = [_specimen(study, campaign), _excitation(study, campaign), _model(study), _experiments(study, campaign)]
    parts += [_observed(study, campaign), _design(study)]
    return [sentence for sentence in parts if sentence]


def _specimen(study: Mapping[str, Any], campaign: Campaign) -> str:
    structure = study.get("structure")
    if structure is None and campaign.protocol != "displacement":
        return ""
    if structure is None:
        return f"The specimen alone, driven by the {campaign.pair.elongation} that was imposed on it (component test)."
    masses = structure["masses"]
    several = structure.get("specimens") or {"": structure.get("specimen")}
    many = f"{len(masses)} masses" if len(masses) > 1 else "one mass"
    sizes = ", ".join("calibrated" if isinstance(mass, Mapping) else f"{mass:g} kg" for mass in masses)
    places = [
        f"{name and name + ', '}between {' and '.join(_end(end) for end in entry['between'])}"
        for name, entry in several.items()
    ]
    what = "A specimen" if len(places) == 1 else f"{len(places)} specimens:"
    return f"{what} {'; '.join(places)}{'' if len(places) == 1 else ';'} of a structure of {many} ({sizes})."


def _end(end: int | str) -> str:
    return "the ground" if end == "ground" else f"mass {end}"


def _excitation(study: Mapping[str, Any], campaign: Campaign) -> str:
    excitation, inputs = study.get("excitation") or {}, study.get("inputs") or {}
    ranges = [
        f"{name} {_prior({k: v for k, v in entry.items() if k != 'unit'})} {unit_words(entry['unit'])}".rstrip(" –")
        for name, entry in inputs.items()
    ]
    varied = f"; inputs {', '.join(ranges)}" if ranges else ""
    for name, known in DECLARED.items():
        if name in excitation:
            return f"{known.sentence(excitation[name], excitation.get('duration'))}{varied}."
    masses = [str(mass) for name in campaign.channels if (mass := driven_mass(name)) is not None]
    if masses:
        return f"Driven by the forces that were measured on mass {' and '.join(masses)}{varied}."
    if study.get("structure") is not None:
        return f"Shaken by the ground motions that were measured{varied}."
    return f"Inputs of the experiments: {', '.join(ranges)}." if ranges else ""


def _prior(prior: Any) -> str:
    if not isinstance(prior, Mapping):
        return f"= {prior:g}"
    if not prior:
        return "by its default prior"
    ((kind, given),) = ((name, value) for name, value in prior.items() if name != "unit")
    numbers = list(given.values()) if isinstance(given, Mapping) else given if isinstance(given, list) else [given]
    if kind == "uniform":
        return f"in {numbers[0]:g} … {numbers[1]:g}"
    return f"~ {kind.replace('_', ' ')}({', '.join(f'{number:g}' for number in numbers)})"


def _model(study: Mapping[str, Any]) -> str:
    several = (study.get("structure") or {}).get("specimens") or {}
    own = {name: entry["model"] for name, entry in several.items() if entry.get("model")}
    parts = [] if own and not study["model"].get("parameters") else [_one_model("Model", study["model"])]
    return " ".join([*parts, *(_one_model(f"Model of {name}", model) for name, model in own.items())])


def _one_model(what: str, model: Mapping[str, Any]) -> str:
    parameters = ", ".join(f"{name} {_prior(prior)}" for name, prior in model["parameters"].items())
    effects = list(model.get("effects") or {})
    known = f" with {_listed(effects)}" if effects else " without further effects"
    if model.get("function"):
        return f"{what}: the function {model['function'].rpartition('/')[2]}; {parameters} (SI)."
    if model.get("command"):
        return f"{what}: the program {model['command']['run']}; {parameters} (SI)."
    if model.get("opensees"):
        known = f"; {parameters} (SI)" if parameters else ""
        return f"{what}: the material {model['opensees']} of OpenSees{known}; other parameters as its table has them."
    return f"{what}: {_law(model['spring'])}{known}; {parameters} (SI)."


def _law(spring: str | Mapping[str, str]) -> str:
    """A spring law in words; the code of a user's own law is not executed."""
    return (
        LAWS[spring].title
        if isinstance(spring, str)
        else f"the spring law {spring['class']} of {spring['file'].rpartition('/')[2]}"
    )


def _experiments(study: Mapping[str, Any], campaign: Campaign) -> str:
    counts = [f"{len(campaign.train)} to fit", *([f"{len(campaign.test)} held out"] if len(campaign.test) else [])]
    other = len(campaign) - len(campaign.completed)
    counts += [f"{other} not completed"] if other else []
    (kind,) = [name for name, entry in study["experiments"].items() if entry is not None]
    if kind == "campaign":
        return f"Experiments: the measured campaign “{campaign.name}”, {', '.join(counts)}."
    if kind != "virtual":
        return f"Experiments: performed by {KINDS[kind].performer}, {', '.join(counts)}."
    virtual = study["experiments"]["virtual"]
    effects = _listed(list(virtual.get("effects") or {})) or "no further effects"
    law = f"is {_law(virtual['spring'])} and " if virtual.get("spring") else ""
    return f"Experiments: a virtual laboratory, {', '.join(counts)}, whose specimen {law}has {effects}, unknown to the model."


def _observed(study: Mapping[str, Any], campaign: Campaign) -> str:
    what = "the time histories"
    if study["observe"] == "quantities":
        what = _listed([*map(campaign.pair.called, study["quantities"])])
    entry = study.get("error") or {}
    of_outputs = {name: value for name, value in entry.items() if isinstance(value, Mapping)}
    observe = study["observe"]
    each = (f"{name} {_error(value, observe)}" for name, value in of_outputs.items())
    said = ", ".join(each) or _error(entry, observe)
    return f"Observed: {what}; error: {said}."


def _error(entry: Mapping[str, Any], observe: str) -> str:
    """The error in words, of all outputs or of one."""
    if entry.get("unknown"):
        said = "inferred"
    elif "relative" in entry:
        said = f"{100 * entry['relative']:g} % of {_RELATIVE_TO[observe, entry.get('of', 'predicted')]}"
    elif "absolute" in entry:
        said = f"{entry['absolute']:g} (SI)"
    else:
        said = "the noise that the campaign declares, otherwise an inferred noise"
    if entry.get("inflate"):
        said += ", and the residual beyond it"
    if entry.get("discrepancy"):
        said += ", and a learned model discrepancy"
    return said


def _design(study: Mapping[str, Any]) -> str:
    steps = f"Steps: {', '.join(study['steps'])}."
    if "design" not in study["steps"]:
        return steps
    design = study["design"]
    by = design["acquisition"].replace("_", " ")
    if (cost := design.get("cost")) is not None:
        by += f" per cost, {' + '.join([f'{cost["fixed"]:g}', *(f'{rate:g} {name}' for name, rate in cost['per'].items())])}"
    return f"{steps} The design starts with {design['initial']} experiments and chooses {design['iterations']} more by {by}."


def _listed(names: list[str]) -> str:
    words = [name.replace("_", " ").replace(".", ": ") for name in names]
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
