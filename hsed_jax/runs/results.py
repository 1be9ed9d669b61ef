"""`results.nc`: posterior, statistics of the sampler, predictions, design and surrogate as one xarray DataTree.

The groups `posterior`, `sample_stats` and `observed_data` are ArviZ's, so ArviZ opens the file as it is. `posterior_improved`,
`sample_stats_improved` and `predictions_improved` are the same of the improved model, and `predictions_with_remainder` those of
the last model with its remainder. `predictions_averaged` are those over the explanations of an ambiguous diagnosis. `ranking` is
the table of the diagnosis, and `discovery` is the function that was learned.
"""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from hsed_jax.analysis.draws import draws_of
from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.locate import Location
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.design.over_inputs import surrogate
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.discovery.findings import Discovery
from hsed_jax.physics.pairs import Pair
from hsed_jax.runs.outcome import Outcome


def results_tree(outcome: Outcome, illustrations: Mapping[str, xr.Dataset]) -> xr.DataTree:
    """Collect the results of a run, with the data of its figures; groups of steps that did not run are absent."""
    groups = dict(illustrations)
    if outcome.fit is not None:
        groups |= draws_of(outcome.fit)
    groups["observed_data"] = _observed(outcome)
    if outcome.comparison is not None:
        groups |= _compared(outcome.comparison, "predictions", outcome.campaign.pair)
    if outcome.location is not None and outcome.location.places:
        groups["where"] = _where(outcome.location)
    if outcome.diagnosis is not None and outcome.diagnosis.ranking:
        groups["ranking"] = _ranking(outcome.diagnosis)
        if (averaged := outcome.diagnosis.averaged) is not None:
            groups |= _predictions(averaged.train, averaged.test, "predictions_averaged", outcome.campaign.pair)
    if outcome.discovery is not None and outcome.discovery.found:
        groups["discovery"] = _discovery(outcome.discovery)
    if outcome.improved is not None:
        groups |= {f"{name}_improved": group for name, group in draws_of(outcome.improved).items()}
    if outcome.improved_comparison is not None:
        groups |= _compared(outcome.improved_comparison, "predictions_improved", outcome.campaign.pair)
    if outcome.remainder is not None and outcome.remainder.helps:
        groups |= _compared(outcome.remainder.after, "predictions_with_remainder", outcome.campaign.pair)
    if outcome.steps:
        groups["design"] = _design(outcome)
        assert outcome.design is not None and outcome.state is not None
        groups["surrogate"] = surrogate(outcome.design, outcome.state, outcome.steps[-1])
    tree = xr.DataTree.from_dict(groups)
    tree.attrs["study"] = outcome.study
    return tree


def _compared(comparison: Comparison, root: str, pair: Pair) -> dict[str, xr.Dataset]:
    return _predictions(comparison.train_prediction, comparison.test_prediction, root, pair)


def _predictions(train: Prediction, test: Prediction | None, root: str, pair: Pair) -> dict[str, xr.Dataset]:
    """Measured and predicted outputs of every compared experiment; histories have one group each.  NaN outside the
    scored window, and for predictions of a diverged simulation.
    """
    groups = {}
    for split, prediction in (("train", train), ("test", test)):
        if prediction is None:
            continue
        if prediction.groups.size == len(prediction.outputs):
            coords = {"experiment": [e.id for e in prediction.experiments]}
            tables = {
                "measured": np.where(prediction.used, prediction.measured, np.nan),
                "predicted": prediction.shown,
                "mean": prediction.mean,
                "sd": prediction.sd,
                **_bands(prediction),
            }
            groups[f"{root}/{split}"] = xr.Dataset(
                {
                    f"{output}_{kind}": ("experiment", table[:, j], {"units": pair.output(output).unit})
                    for j, output in enumerate(prediction.outputs)
                    for kind, table in tables.items()
                },
                coords,
            )
            continue
        for row, experiment in enumerate(prediction.experiments):
            assert experiment.record is not None
            histories = {}
            for output in prediction.outputs:
                measured, *ours = prediction.histories(row, output)
                scored = prediction.used[row, prediction.columns(output)][: measured.size]
                tables = (np.where(scored, measured, np.nan), *ours)
                kinds = dict(zip(("measured", "predicted", "mean", "sd"), tables, strict=True))
                columns = prediction.columns(output)
                kinds |= {kind: table[row, columns][: measured.size] for kind, table in _bands(prediction).items()}
                for kind, values in kinds.items():
                    histories[f"{output}_{kind}"] = ("time", values, {"units": pair.output(output).unit})
            time = {"time": ("time", experiment.record.time, {"units": "s"})}
            groups[f"{root}/{split}/{experiment.id}"] = xr.Dataset(histories, time)
    return groups


def _bands(prediction: Prediction) -> dict[str, np.ndarray]:
    """The parts of the band, and the band without the discrepancy."""
    found = {f"sd_{name}": part for name, part in prediction.parts.items()}
    if prediction.without is not None:
        found |= {"mean_without": prediction.without.mean, "sd_without": prediction.without.sd}
    return found


def _where(location: Location) -> xr.Dataset:
    """The places of the misfit, ranked."""
    places = location.places
    return xr.Dataset(
        {
            "coordinate": ("rank", [place.coordinate for place in places]),
            "sentence": ("rank", [place.sentence for place in places]),
            "error_share": ("rank", [place.error_share for place in places]),
            "sample_share": ("rank", [place.sample_share for place in places]),
            "information": ("rank", [place.information for place in places]),
        },
        {"rank": np.arange(1, len(places) + 1)},
    )


def _ranking(diagnosis: Diagnosis) -> xr.Dataset:
    """The candidates of a diagnosis, ranked; the amplitude is the first parameter of an effect, dimensionless."""
    candidates = diagnosis.ranking
    table: dict = {
        key: ("rank", [getattr(c, key) for c in candidates])
        for key in ("effect", "family", "probability", "log_evidence_gain", "rao_statistic", "rao_p_value", "error_train",
                    "error_test")
    }  # fmt: skip
    amplitudes = [next(iter(c.estimate.values())) for c in candidates]
    for statistic in ("mean", "sd", "q05", "q95"):
        table[f"amplitude_{statistic}"] = ("rank", [amplitude[statistic] for amplitude in amplitudes])
    table["named"] = ("rank", [c.effect in diagnosis.effects for c in candidates])
    return xr.Dataset(table, {"rank": np.arange(1, len(candidates) + 1)}, {"verdict": diagnosis.verdict})


def _discovery(discovery: Discovery) -> xr.Dataset:
    """The learned function along its first coordinate, SI, a line for each value of the second."""
    assert discovery.place is not None
    lines = discovery.lines()
    table: dict = {
        key: (("line", "point"), [getattr(line, key) for line in lines]) for key in ("x", "mean", "low", "high")
    }
    if lines[0].formula is not None:
        table["formula"] = (("line", "point"), [line.formula for line in lines])
    if lines[0].at is not None:
        table["at"] = ("line", [line.at for line in lines])
    about = {"slot": discovery.place.slot, "of": list(discovery.place.of), "formula": discovery.formula}
    return xr.Dataset(table, attrs=about)


def _observed(outcome: Outcome) -> xr.Dataset:
    """Measured quantities and inputs of the experiments, where quantities are observed."""
    experiments, pair = outcome.campaign.experiments, outcome.campaign.pair
    coords: dict = {"experiment": [e.id for e in experiments]}
    for name in outcome.campaign.inputs:
        unit = outcome.campaign.unit(name)
        coords[name] = ("experiment", [float(unit.from_si(e.inputs[name])) for e in experiments], {"units": unit.text})
    columns = {
        name: ("experiment", [e.quantities.get(name, np.nan) for e in experiments], {"units": pair.output(name).unit})
        for name in outcome.campaign.quantities
    }
    return xr.Dataset(columns, coords)


def _design(outcome: Outcome) -> xr.Dataset:
    names = list(outcome.posterior.names)
    steps = outcome.steps
    table = {
        "max_expected_improvement": ("step", outcome.improvements),
        "acquisition": ("step", [step["acquisition"] for step in steps]),
        "log_evidence": ("step", [step["log_evidence"] for step in steps]),
        "divergences": ("step", [step["divergences"] for step in steps]),
        "map": (("step", "parameter"), [[step["map"][n] for n in names] for step in steps]),
    }
    for statistic in ("mean", "sd", "q05", "q95", "ess_bulk", "rhat"):
        table[statistic] = (("step", "parameter"), [[step["posterior"][n][statistic] for n in names] for step in steps])
    return xr.Dataset(table, {"step": np.arange(len(steps)), "parameter": names})
