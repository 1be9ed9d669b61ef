"""Writes `docs/opensees_laws.md`: the materials of OpenSees that are models, with their parameters, from the code alone."""

import inspect
import math
from pathlib import Path

from hsed_jax.models.opensees import MATERIALS
from hsed_jax.models.opensees.base import MaterialParameter, Scaled

PAGE = Path(__file__).parent / "opensees_laws.md"

HEAD = """# Laws of OpenSees

*Written by `python docs/opensees_laws.py` from the code; not to be edited by hand.*

Engineers model members and joints with materials of OpenSees. hsed_jax calibrates eight of these materials on a test
with imposed elongation, gives intervals, and exports them. OpenSees itself simulates the material, so the exported
script has the same forces. You need openseespy: `python -m pip install 'hsed_jax[opensees]'`.

```
hsed init column.csv --model opensees:Pinching4   # a campaign and its study, with priors from the record
hsed run column/study.yaml
hsed laws column/study.yaml                       # all materials, ranked by their held-out error
hsed export runs/column --opensees                # specimen.py, specimen.tcl, protocol.csv, check.json
```

## In a study

`model: {opensees: Pinching4}` is enough. A parameter that you leave out has the value or the prior of the tables below. A number
fixes a parameter, a prior frees it, and `{}` frees it with the prior of the table:

```yaml
model:
  opensees: Pinching4
  parameters: {gK2: 0.0, negative: {}, k: {lognormal: [16.9, 0.3]}}
  search: 2000
```

- **Priors come from the record**: the initial stiffness, the largest force, the largest elongation, and the path (absorbed energy
  over the largest force) of the training experiments.
- **Zero is allowed.** A parameter of degradation has a prior that is highest at zero, and zero switches the degradation off.
- **A material is symmetric** unless you free `negative`, the strength of the negative side over that of the positive side.
- **The search.** The response of these materials has kinks and several minima. Differential evolution with `model.search`
  simulations comes first. Descents with finite differences start at its result and at other points of the priors
  (`calibration.starts`). Samplers are [those of every model](parts.md#samplers).
- **Steps.** OpenSees follows the elongation in steps of at most a hundredth of the largest one.
- **Failures.** OpenSees runs in separate processes. A simulation that crashes, gives no finite force or takes longer
  than {timeout:g} s counts as diverged.

`calibrate`, `compare` and the report work as with any model. `diagnose`, `discover` and `improve` need a
[spring law](laws.md) and refuse a material. A specimen in a structure needs a spring law, too; OpenSees can be
[its laboratory](laboratories.md#opensees).

## Comparison of laws

`hsed laws STUDY.yaml` calibrates the model of the study and the materials, each in its own run folder;
`--materials Pinching4,SAWS` selects materials (in Python: `hx.laws`). It ranks them by the error on held-out data: the
end of the record that `hsed init` holds out, or the experiments of the split `test`. `laws.json` has the errors. A
small error on the fitted part is not sufficient: a law with more parameters fits better and may predict worse.

## Export

`hsed export RUN --opensees` writes the material at the MAP. It runs the script in OpenSees along the first experiment
(`protocol.csv`) and compares it with the simulation. `check.json` and the head of the scripts have the difference (root
mean square, over the standard deviation of the force) and the version of OpenSees. `report.html` of the run states
both. In another version an argument may have another meaning: run `python specimen.py protocol.csv` with that version,
and compare with the second column of `protocol.csv`. `tests/models/test_opensees_laws.py` does this for every material; the
test allows 1 %.

## Materials

| material | what it is | free parameters |
|---|---|---|
"""


def page() -> str:
    """The text of `docs/opensees_laws.md`."""
    from hsed_jax.models.opensees.workers import TIMEOUT

    index, parts = [], []
    for name, material in MATERIALS.items():
        first, _, rest = inspect.cleandoc(material.__doc__ or "").partition("\n")
        free = sum(known.value is None for known in material.parameters.values())
        index.append(f"| [`{name}`](#{name.lower()}) | {first} | {free} |")
        parts += [
            f"\n### {name}\n",
            f"{first}\n{rest}".strip(),
            "",
            "| parameter | symbol | unit | meaning | value, if left out | prior | range |",
            "|---|---|---|---|---|---|---|",
            *(_row(key, known) for key, known in material.parameters.items()),
            "",
            f"Reference: {material.reference}.",
        ]
    text = HEAD.replace("{timeout:g}", f"{TIMEOUT:g}") + "\n".join([*index, *parts]) + "\n"
    return text.replace("\\,", "\\thinspace ")


def _row(name: str, known: MaterialParameter) -> str:
    value = "free" if known.value is None else f"{known.value:g}"
    low, high = (f"{bound:g}" if math.isfinite(bound) else "∞" for bound in (known.lower, known.upper))
    cells = (f"`{name}`", f"${known.symbol}$", known.unit, known.meaning, value, _prior(known), f"{low} to {high}")
    return f"| {' | '.join(cells)} |"


def _prior(known: MaterialParameter) -> str:
    if isinstance(known.prior, Scaled):
        return known.prior.words
    if known.prior is None:
        return "–"
    ((kind, given),) = known.prior.items()
    numbers = given if isinstance(given, list) else [given]
    return f"{kind.replace('_', '-')} {', '.join(f'{number:g}' for number in numbers)}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
