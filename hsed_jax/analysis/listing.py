"""The catalogue of effects as a table for a notebook."""

from typing import TYPE_CHECKING

from hsed_jax.config.schema import Study
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.reporting.catalogue import first_line
from hsed_jax.study.own_parts import catalogue_of

if TYPE_CHECKING:
    import pandas as pd


def effects(study: Study | None = None) -> "pd.DataFrame":
    """The physical effects that a model can be given, one row each, sorted by name.

    Arguments:
        study: a study with its own effects, which are then in the table, too.

    Returns:
        By name: the `family`, the action of the effect (`meaning`), the names of its `parameters` and the labels of its
        `forms`, each joined by commas, and its `reference`.

    Example:
        >>> hx.effects().loc["slip", "family"]
        'pinching'
    """
    import pandas as pd

    catalogue = EFFECTS if study is None else catalogue_of(study)
    rows = {
        name: {
            "family": effect.family,
            "meaning": first_line(effect),
            "parameters": ", ".join(key for key, known in parameters_of(effect).items() if not known.shapes),
            "forms": ", ".join(form.label for form in effect.forms),
            "reference": effect.reference,
        }
        for name, effect in sorted(catalogue.items())
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("effect")
