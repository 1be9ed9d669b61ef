"""What the discrepancy of a study's model is a function of."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hsed_jax.config.functions import FunctionEntry
from hsed_jax.errors import UserError
from hsed_jax.physics.simulator import Conditions

if TYPE_CHECKING:
    from hsed_jax.inference.discrepancy import Support
    from hsed_jax.study.build import Built

# Inputs that represent their distribution: a simulation each.
_SPREAD = 128
# Of fewer shaken experiments nobody knows how far the best parameters of another one are from theirs: with one, bands held 60 %
# of new records instead of 90 %; with two, 43 % in the worst of 20 campaigns, and intervals one value in two.
_LEAST_SHAKEN = 3


def check_told(built: "Built", experiments: int | None = None) -> None:
    """Refuse a discrepancy of histories that too few shaken experiments tell; a component test imposes the motion.

    Arguments:
        built: the study.
        experiments: how many there are to calibrate on; by default those measured, or planned.

    Raises:
        UserError: there are fewer than three experiments of a structure.
    """
    if experiments is None:
        design, measured = built.study.design, built.measured
        planned = design.initial + ("design" in built.study.steps) * design.iterations
        experiments = planned if measured is None else len(measured.train)
    wrong = built.study.observe == "histories" and any(error.discrepancy for error in built.errors)
    if wrong and 0 < experiments < _LEAST_SHAKEN and not built.component_test:
        many = "one experiment does" if experiments == 1 else "two experiments do"
        raise UserError(
            f"error.discrepancy: {many} not tell how far another one would be from the model, and bands and intervals would be "
            f"too narrow; give at least {_LEAST_SHAKEN} experiments, or say inflate: true in place of discrepancy: true"
        )


def support_of(built: "Built") -> "Support | None":
    """What a discrepancy of quantities is a function of: the inputs, in the unit cube of their distributions.

    Its orthogonality is taken over the distribution of the inputs where the model can be simulated at any of them, else over the
    experiments: where each brings its record, and where every prediction is a program's.

    Returns:
        None where none is asked for, or of histories, whose discrepancy is one over the cycles of the response.

    Raises:
        UserError: the experiments do not say one of them.
    """
    if built.study.observe == "histories" or not any(error.discrepancy for error in built.errors):
        return None
    from hsed_jax.inference.discrepancy import Support

    space = built.space

    def cube(inputs: Mapping[str, Array]) -> np.ndarray:
        if missing := [name for name in space.names if name not in inputs]:
            raise UserError(f"error.discrepancy: the experiments do not say their input {missing[0]}")
        return space.cube(np.stack([np.asarray(inputs[name]) / space.factors[name] for name in space.names], axis=1))

    is_program = isinstance(built.study.model, FunctionEntry) and built.study.model.command is not None
    if built.grid is not None or is_program:
        return Support(space.names, cube, None)
    inputs = space.si(space.declared(space.spread(_SPREAD)))
    return Support(space.names, cube, Conditions({name: jnp.asarray(values) for name, values in inputs.items()}))
