"""The sequential design of a study, and the sizes of its calibrations."""

from typing import TYPE_CHECKING

from hsed_jax.design.sequential import SequentialDesign
from hsed_jax.inference.nuts import Settings

if TYPE_CHECKING:
    from hsed_jax.config.build import Built


def design_of(built: "Built") -> SequentialDesign:
    """The sequential design; its calibrations between two experiments are smaller than the last one."""
    entry, sizes = built.study.design, built.study.calibration
    return SequentialDesign(
        posterior=built.posterior,
        space=built.space,
        size=entry.initial + entry.iterations,
        gaps=built.observation.gaps(None),
        settings=Settings(sizes.chains, sizes.step_warmup, sizes.step_draws, sizes.target_acceptance, sizes.sampler),
        starts=sizes.starts,
        candidates=entry.candidates,
        acquisition=entry.acquisition,
        kriging=entry.kriging.model_dump(),
        variance_over_parameters=entry.variance == "inputs_and_parameters",
        seed=built.study.seed,
        exceeding=built.limits,
    )
