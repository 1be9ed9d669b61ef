"""A model that is a function: from parameters and the conditions of an experiment to its predicted outputs."""

from collections.abc import Callable, Mapping
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.physics.excitations import AbstractExcitation, Imposed, Tabulated, channels_of
from hsed_jax.physics.names import owner_of
from hsed_jax.physics.outputs import is_driver, is_quantity, output
from hsed_jax.physics.response import Response
from hsed_jax.physics.simulator import AbstractModel, Conditions, Scalar
from hsed_jax.physics.timeline import Timeline

Respond = Callable[[Mapping[str, Any], Mapping[str, Any]], Mapping[str, Any]]
"""From parameters by name, and from the inputs of an experiment by name (SI) with its `time` and its excitation, to
quantities (numbers) and channels (one number for each time), by name and in SI.
"""


@final
class FunctionModel(AbstractModel):
    """A function as the model of a study.

    Attributes:
        function: traceable by JAX, as `Differenced` makes any.
        given: the quantities and channels that it returns.
        excitation: from inputs to the excitation; None if every experiment has its record, or there is no excitation.
        timeline: the times of an experiment without a record; None without an excitation.
        constants: parameters that are fixed numbers.
    """

    function: Respond = eqx.field(static=True)
    given: tuple[str, ...] = eqx.field(static=True)
    excitation: Callable[[Mapping[str, Scalar]], AbstractExcitation] | None
    timeline: Timeline | None = eqx.field(static=True)
    constants: tuple[tuple[str, float], ...] = eqx.field(static=True, default=())

    @property
    def owners(self) -> tuple[str, ...]:
        """The specimens of the outputs of the function; the name of a single specimen is empty."""
        return tuple(dict.fromkeys(owner_of(name) for name in self.given if output(name).of_specimen)) or ("",)

    def gives(self, name: str) -> bool:
        """Whether the function returns it."""
        return name in self.given

    @property
    def references(self) -> dict[str, str]:
        """None: it is the user's own."""
        return {}

    @eqx.filter_jit
    def respond(
        self,
        parameters: Mapping[str, Scalar],
        conditions: Conditions,
        channels: tuple[str, ...] = (),
        quantities: tuple[str, ...] = (),
    ) -> Response:
        """The output of the function for one experiment; not ok if an output is not finite.

        Arguments:
            parameters: by name.
            conditions: inputs and record of the experiment.
            channels: names of the histories to keep.
            quantities: not used, because the outputs of the function are known.
        """
        returned = self.function({**dict(self.constants), **parameters}, self.told(conditions))
        found = {name: jnp.asarray(returned[name], dtype=float) for name in self.given}
        ok = jnp.all(jnp.stack([jnp.all(jnp.isfinite(values)) for values in found.values()]))
        values = {name: value for name, value in found.items() if is_quantity(name)}
        return Response(values, {name: found[name] for name in channels}, ok)

    def told(self, conditions: Conditions) -> dict[str, Any]:
        """The input of the function for an experiment: the inputs (SI), and, if they exist, the times [s] from 0 and the
        excitation, each (n,): `ground_acceleration`, `applied_force_i` on mass i, or `elongation` and `elongation_rate`.

        A record that is shorter than the longest one is padded with its last sample, at the same time.
        """
        known: dict[str, Any] = dict(conditions.inputs)
        if conditions.recorded is not None:
            forcing, lengths, *_ = conditions.recorded
            assert isinstance(forcing, Tabulated)
            known["time"] = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.asarray(lengths))])
            # Its samples are on half steps.
            return known | _histories(jax.tree.map(lambda values: values[::2], forcing.samples))
        if self.excitation is None or self.timeline is None:
            return known
        time = self.times(conditions.inputs)
        return known | {"time": time} | _histories(jax.vmap(self.excitation(conditions.inputs).sample)(time))


def _histories(samples: Any) -> dict[str, Any]:
    """Samples of the excitation of an experiment, by name."""
    rate = {"elongation_rate": samples.rate} if isinstance(samples, Imposed) else {}
    return channels_of(samples) | rate


def is_told(name: str) -> bool:
    """Whether a function may get a history of this name."""
    return is_driver(name) or name in ("elongation", "elongation_rate")


def outputs_of(returned: Any, time: np.ndarray | None, wanted: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The output of a function: quantities of shape () and channels of the shape of the times; other names are left out.

    Arguments:
        returned: by the function.
        time: of its input, (n,); None without times.
        wanted: names that must be there.

    Raises:
        UserError: it is not a mapping, a name is missing, or a value has another shape or is not a number.
    """
    found = {}
    for name, value in known_outputs(returned, wanted).items():
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise UserError(f"its {name} is {value!r:.60}; numbers are wanted") from None
        if is_quantity(name):
            shape, words = (), "a quantity is one number"
            array = array.reshape(()) if array.size == 1 else array
        elif time is None:
            raise UserError(f"it returned the channel {name}, but no excitation and no record gives its times")
        else:
            shape, words = time.shape, f"a channel has the shape of the times, {time.shape}"
        if array.shape != shape:
            raise UserError(f"its {name} has the shape {array.shape}; {words}")
        found[name] = array
    return found


def known_outputs(returned: Any, wanted: tuple[str, ...]) -> dict[str, Any]:
    """The quantities and channels in the output of a function, by name.

    Raises:
        UserError: it is not a mapping, or a required name is missing.
    """
    if not isinstance(returned, Mapping):
        raise UserError(f"it returned {returned!r:.60}; a mapping of names to numbers or arrays is wanted")
    if missing := [name for name in wanted if name not in returned]:
        names = ", ".join(map(str, returned)) or "nothing"
        raise UserError(f"it returned no {missing[0]}; the study observes {', '.join(wanted)}, and it returned {names}")
    return {name: value for name, value in returned.items() if is_output(name)}


def is_output(name: Any) -> bool:
    """Whether this is the name of a quantity, or of a channel that can be predicted."""
    if not isinstance(name, str) or is_driver(name):
        return False
    try:
        output(name)
    except KeyError:
        return False
    return True
