"""A first study for a campaign, ready to be calibrated: the object form of the file that `hsed init` writes."""

from collections.abc import Sequence
from pathlib import Path

from hsed_jax.config.load import load_study
from hsed_jax.config.schema import Study
from hsed_jax.drafting.initial import Frame, text_of_study
from hsed_jax.drafts import write_whole
from hsed_jax.measurements import Campaign
from hsed_jax.plain import parse_yaml
from hsed_jax.study.first_material import material_lines


def initial_study(
    campaign: Campaign,
    file: str | Path | None = None,
    *,
    masses: Sequence[float] = (),
    height: float = 0.0,
    model: str | None = None,
) -> Study:
    """A study for a campaign, with priors around the stiffness and strength that its records show.

    Arguments:
        campaign: the measurements.
        file: where to write the study, with a comment beside each number that gives its source.
        masses: of a shaken frame: masses of its floors from the lowest up [kg].
        height: height of a storey [m]: gravity acts on its drift.
        model: `opensees:` and a material, such as `opensees:Pinching4`; by default a spring law that fits the records.

    Returns:
        The study. It names the folder that the campaign was read from; of a campaign made in memory, it names the folder of
        `file`.

    Raises:
        UserError: the campaign has no completed training experiment, or its records do not show stiffness and strength; or
            masses and height do not fit the sensors.

    Example:
        >>> study = hx.initial_study(hx.read_files("wall.csv"), "wall.yaml")
        >>> study.model.spring, study.observe
        ('bouc_wen', 'histories')
    """
    output = Path(file) if file is not None else Path("study.yaml")
    folder = Path(campaign.source) if campaign.source else output.parent / campaign.name
    lines = [] if model is None else material_lines(model, campaign)
    text = text_of_study(campaign, folder, output, Frame(tuple(masses), height), model=lines)
    if file is not None:
        write_whole(output, text)
        return load_study(output)
    return load_study(parse_yaml(text, "initial study"))
