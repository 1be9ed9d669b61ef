"""The model of a first study that is a material of OpenSees: its parameters, with priors from the record."""

import math
from typing import Any, cast

from hsed_jax.config.opensees import asked_material
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign
from hsed_jax.models.opensees import MATERIALS
from hsed_jax.study.opensees_study import marks_of

PREFIX = "opensees:"


def material_lines(model: str, campaign: Campaign) -> list[str]:
    """The lines of `model` in a study file.

    Arguments:
        model: `opensees:` and the name of a material.
        campaign: the measurements that the priors come from.

    Raises:
        UserError: there is no such material, the elongation was not imposed, or the records do not determine a prior.
    """
    if not model.startswith(PREFIX):
        raise UserError(f"--model {model}: write {PREFIX} and a material, such as {PREFIX}Pinching4")
    name = asked_material(model.removeprefix(PREFIX), "--model")
    if campaign.protocol != "displacement":
        raise UserError(f"--model {model}: a material of OpenSees needs a test whose elongation was imposed")
    marks, pair = marks_of(campaign), campaign.pair
    lines = ["model:", f"  opensees: {name}", "  parameters:"]
    for key, known in MATERIALS[name].parameters.items():
        if known.value is not None:
            lines.append(
                f"    {key}: {known.value:g}  # {pair.words(known.meaning)}; {{}} frees it, with the prior of the table"
            )
            continue
        prior = known.prior_of(marks)
        if prior is None:
            raise UserError(f"--model {model}: the records do not determine a prior of {key}, {known.meaning}")
        lines.append(f"    {key}: {_flow(prior)}  # {pair.words(known.meaning)} [{pair.unit(known.unit)}]")
    return [*lines, "  search: 2000  # simulations of the search before the descents"]


def _flow(prior: dict[str, Any]) -> str:
    ((kind, given),) = prior.items()
    numbers = cast("list[float]", given if isinstance(given, list) else [given])
    text = ", ".join(map(_decimal, numbers))
    return f"{{{kind}: {f'[{text}]' if isinstance(given, list) else text}}}"


def _decimal(number: float) -> str:
    """A number that YAML reads back as a number."""
    text = f"{number:.4g}" if math.isfinite(number) else str(number)
    return text if "e" not in text or "." in text else text.replace("e", ".0e")
