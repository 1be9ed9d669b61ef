r"""A calibrated law as input of SAP2000, SeismoStruct and Abaqus, only if they have an equal law.

*Bilinear with kinematic hardening* is `bl_kin` of SeismoStruct, a link MultiLinear Plastic of the type Kinematic of SAP2000, and
connector plasticity of Abaqus with linear kinematic hardening, $\dot\alpha = C\,\dot u_p$ with $C = bk/(1-b)$.

*Bouc–Wen with γ = β* is the link Plastic (Wen) of SAP2000,

$$f = r k d + (1-r)\,y z,\qquad
  \dot z = \frac{k}{y}\begin{cases}(1-|z|^{e})\,\dot d & \dot d\,z > 0\\ \dot d & \text{else,}\end{cases}$$

which unloads elastically.  A linear `hardening` of both sides beside either law changes stiffness, yield force and ratio alone.

Source: CSI Analysis Reference Manual (Wen plasticity, multi-linear kinematic plasticity); SeismoStruct User Manual (bl_kin);
Abaqus Analysis User's Guide (connector plastic behavior).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from hsed_jax.errors import UserError
from hsed_jax.physics.effects.base import AbstractSpringEffect
from hsed_jax.physics.laws.base import AbstractSpringLaw
from hsed_jax.physics.pairs import Pair
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.scales import Scales


class Entry(NamedTuple):
    """A number for a program.

    Attributes:
        program, element: which, and its element or curve.
        name: of the number there.
        value: SI.
        unit: SI.
    """

    program: str
    element: str
    name: str
    value: float
    unit: str


def entries(
    law: AbstractSpringLaw, effects: Mapping[str, AbstractSpringEffect], scales: Scales, reach: float, pair: Pair
) -> list[Entry]:
    """The numbers of a law for all programs that have it.

    Arguments:
        law: with its calibrated parameters, numbers.
        effects: in the spring, by name, with theirs.
        scales: characteristic values of the effects.
        reach: largest elongation of the experiments [m]; a curve in points goes to ten times as far.
        pair: gives the units.

    Raises:
        UserError: no program has this law, or these effects.
    """
    beside = _beside(effects, scales)
    if law.name == "bilinear":
        return _bilinear(law, beside, reach, pair)
    if law.name == "bouc_wen":
        return _wen(law, effects, beside, pair)
    raise UserError(
        f"the law {law.name} is equal to none of SAP2000, SeismoStruct and Abaqus; bilinear is, and bouc_wen with gamma = beta: "
        "calibrate one of them (model.spring), and export that run"
    )


def markdown(title: str, table: list[Entry]) -> str:
    """The table in Markdown."""
    lines = ["| program | element | parameter | value | unit |", "| --- | --- | --- | --- | --- |"]
    lines += [f"| {e.program} | {e.element} | {e.name} | {e.value:.9g} | {e.unit} |" for e in table]
    return "\n".join([f"# {title}", "", *lines, ""])


def _bilinear(law: Any, beside: float, reach: float, pair: Pair) -> list[Entry]:
    force, length, stiffness = pair.unit("N"), pair.unit("m"), pair.unit("N/m")
    u_y = law.F_y / law.k
    k, post, F_y = law.k + beside, law.b * law.k + beside, law.F_y + beside * u_y
    far = max(10 * reach, 100 * u_y)
    abaqus, sap = "connector plasticity, TYPE=KINEMATIC, DEFINITION=PARAMETERS", "link MultiLinear Plastic, Kinematic"
    points = [(u, F_y + post * (u - u_y) if u > u_y else k * u) for u in (u_y, far)]
    return [
        Entry("SeismoStruct", "bl_kin", "Fy", F_y, force),
        Entry("SeismoStruct", "bl_kin", "K0", k, stiffness),
        Entry("SeismoStruct", "bl_kin", "r", post / k, "1"),
        *(
            Entry("SAP2000", sap, f"{what} of point {place} (and its negative)", value, unit)
            for place, (u, f) in enumerate(points, 1)
            for what, value, unit in (("deformation", u, length), ("force", f, force))
        ),
        Entry("Abaqus", "connector elasticity", "D11", k, stiffness),
        Entry("Abaqus", abaqus, "yield force", F_y, force),
        Entry("Abaqus", abaqus, "C", k * post / (k - post), stiffness),
        Entry("Abaqus", abaqus, "gamma", 0.0, pair.unit("1/m")),
    ]


def _wen(law: Any, effects: Mapping[str, Any], beside: float, pair: Pair) -> list[Entry]:
    shape = [effect.delta for effect in effects.values() if effect.name == "loop_shape"]
    gamma = law.gamma + sum(shape) * law.beta
    if gamma != law.beta or law.n < 1:
        raise UserError(
            f"bouc_wen with beta = {float(law.beta):.4g}, gamma = {float(gamma):.4g}, n = {float(law.n):.4g}: Plastic (Wen) of "
            "SAP2000 has gamma = beta and n of at least 1; calibrate with gamma: 0, effects: {loop_shape: {delta: 1.0}} in the "
            "model, and export that run"
        )
    strength = (law.A / (2 * law.beta)) ** (1 / law.n)
    k, element = law.A + beside, "link Plastic (Wen)"
    ratio = beside / k
    return [
        Entry("SAP2000", element, "Stiffness", k, pair.unit("N/m")),
        Entry("SAP2000", element, "Yield Strength", strength / (1 - ratio), pair.unit("N")),
        Entry("SAP2000", element, "Post Yield Stiffness Ratio", ratio, "1"),
        Entry("SAP2000", element, "Yielding Exponent", law.n, "1"),
    ]


def _beside(effects: Mapping[str, AbstractSpringEffect], scales: Scales) -> float:
    """The stiffness of linear hardening beside the law [N/m].

    Raises:
        UserError: another effect acts.
    """
    stiffness = 0.0
    for name, effect in effects.items():
        given: Any = effect
        if getattr(effect, next(iter(parameters_of(effect)))) == 0:
            continue
        if effect.name == "hardening" and all(
            getattr(given, key, value) == value for key, value in (("power", 1), ("bend", 0), ("side", 0), ("worn", 0))
        ):
            stiffness += float(given.delta * scales.force / scales.elongation)
        elif effect.name != "loop_shape" or given.power != 0 or given.kept != 0:
            raise UserError(
                f"{name} has no equal counterpart in SAP2000, SeismoStruct and Abaqus; calibrate without it (or say "
                "--before for the model before its improvement), and export that run"
            )
    return stiffness
