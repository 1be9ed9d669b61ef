"""The sequential design of a study, and sizes of its samples."""

from typing import TYPE_CHECKING

from hsed_jax.config.schema import CalibrationEntry
from hsed_jax.design.cost import Cost

if TYPE_CHECKING:
    # A check of a study samples nothing, and need not wait for what does.
    from hsed_jax.design.sequential import SequentialDesign
    from hsed_jax.inference.nuts import Settings
    from hsed_jax.study.build import Built


def settings_of(sizes: CalibrationEntry) -> "Settings":
    """Sizes of the sample of a calibration."""
    from hsed_jax.inference.nuts import Settings

    return Settings(sizes.chains, sizes.warmup, sizes.draws, sizes.target_acceptance, sizes.sampler)


def design_of(built: "Built") -> "SequentialDesign":
    """The sequential design; each of its steps has a smaller sample than a calibration."""
    from hsed_jax.design.sequential import SequentialDesign

    entry, sizes = built.study.design, built.study.calibration
    return SequentialDesign(
        posterior=built.posterior,
        space=built.space,
        size=entry.initial + entry.iterations,
        gaps=built.observation.gaps(None),
        settings=built.settings._replace(warmup=sizes.step_warmup, draws=sizes.step_draws),
        starts=sizes.starts,
        candidates=entry.candidates,
        acquisition=entry.acquisition,
        kriging=entry.kriging.model_dump(),
        variance_over_parameters=entry.variance == "inputs_and_parameters",
        seed=built.study.seed,
        exceeding=built.limits,
        cost=None if entry.cost is None else Cost(entry.cost.fixed, entry.cost.per, built.space),
        replicates=entry.replicates,
    )
