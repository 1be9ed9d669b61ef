"""Long records of component tests: what is kept, what that costs, and that the rest of the package follows."""

import re
from dataclasses import replace

import numpy as np
import pytest
from builders.misfits import prediction

import hsed_jax as hx
from hsed_jax.criticism.prediction import largest_noise, noise_sizes
from hsed_jax.errors import UserError
from hsed_jax.inference.observation import Grid, conditions_of, first_alike
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import Campaign, Experiment, Record, characteristics
from hsed_jax.measurements.noise import noise_estimate
from hsed_jax.measurements.thinning import loss, thinned
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws import BoucWen
from hsed_jax.reporting.page_tables import _predicted_part
from hsed_jax.study.advice import forecast
from hsed_jax.study.build import Built
from hsed_jax.study.specimens import Naming
from hsed_jax.study.timelines import imposed_grid

STRENGTH, YIELD, ROWS = 1e5, 5e-3, 28000


def long_record(rows: int = ROWS, noise: float = 1e-3) -> Record:
    """Cycles of growing amplitude at constant speed, and the force of an elastoplastic spring (rounded); no time."""
    rng = np.random.default_rng(0)
    corners = np.concatenate([[0.0], np.repeat([3, 10, 25, 60, 100], 6) * 1e-3 * np.tile([1, -1], 15), [0.0]])
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners)))])
    elongation = np.interp(np.linspace(0, way[-1], rows), way, corners)
    force = np.zeros(rows)
    for k, step in enumerate(np.diff(elongation), 1):
        towards = np.sign(step) * STRENGTH
        force[k] = towards + (force[k - 1] - towards) * np.exp(-abs(step) / YIELD)
    return Record(
        np.arange(rows), {"elongation": elongation, "force": force + noise * STRENGTH * rng.normal(size=rows)}
    )


def campaign_of(record: Record) -> Campaign:
    return Campaign.from_frames(
        [{"id": "E01", "from": 0, "to": 1500}, {"id": "E02", "from": 1500, "to": len(record) - 1, "split": "test"}],
        records=dict.fromkeys(("E01", "E02"), record.channels),
        protocol="displacement",
        channels={"elongation": "m", "force": "N"},
    )


def study_of(**more):
    law = {"A": {"lognormal": [np.log(STRENGTH / YIELD), 0.3]}, "beta": {"lognormal": [-np.log(YIELD), 0.3]}}
    content = {"study": "long", "model": {"parameters": law}, "experiments": {"campaign": "."}, "observe": "histories"}
    return hx.load_study({**content, "error": {"absolute": 0.02 * STRENGTH}, **more})


def test_a_long_record_keeps_its_reversals_extremes_ends_and_window():
    record = long_record()
    experiment = Experiment("E01", record=record, window=(1234, 20000))
    thin = thinned(experiment, 4000).record
    assert 3000 < len(thin) <= 4000 and set(thin.time) <= set(record.time)
    assert {0, 1234, 20000, ROWS - 1} <= set(thin.time)
    turned = np.flatnonzero(np.diff(np.sign(np.diff(record["elongation"]))) != 0) + 1
    assert turned.size == 30 and set(turned) <= set(thin.time)
    for name, values in record.channels.items():
        assert (thin[name].max(), thin[name].min()) == (values.max(), values.min())
        np.testing.assert_array_equal(thin[name], values[thin.time.astype(int)])
    # The smallest cycles are 1.5 % of the path and keep 5 % of the samples.
    small = np.count_nonzero(thin.time < turned[5])
    assert small > 0.04 * len(thin)


def test_the_windows_of_a_thinned_record_have_one_simulation():
    campaign = campaign_of(long_record())
    third = replace(campaign["E02"], id="E03", window=(20000, 25000))
    campaign = replace(campaign, experiments=(*campaign, third))
    built = Built(study_of(measurements={"samples": 600}), campaign)
    train, test = (built.experiments.taken(part.experiments) for part in (campaign.train, campaign.test))
    # They keep the ends of all windows, whichever is taken.
    assert {0, 1500, 20000, 25000, ROWS - 1} <= set(train[0].record.time)
    assert train[0].record == test[0].record != long_record()
    data = built.inference.data(campaign, campaign.experiments)
    assert first_alike(data.conditions).tolist() == [0, 0, 0]
    # An experiment of another record keeps its own samples.
    other = Experiment("E04", record=long_record(noise=0.0), window=(7, 900))
    assert {7, 900} <= set(thinned(other, 600, campaign.experiments).record.time)


def test_what_thinning_costs_is_small_and_said():
    record = long_record()
    experiment = Experiment("E01", record=record)
    lost = loss(record, thinned(experiment, 4000).record)
    # Noise of 0.05 % of the range is nearly all of it.
    assert lost.deviation < 1e-3 and lost.energy < 1e-3
    assert "from 28000 to" in str(lost) and "dissipated energy changes by 0.0" in str(lost)
    coarse = loss(record, thinned(experiment, 400).record)
    assert coarse.deviation > lost.deviation and coarse.kept <= 400


def test_the_noise_of_a_thinned_record_is_that_of_all_its_samples():
    experiment = thinned(Experiment("E01", record=long_record()), 200)
    record = experiment.record
    assert record.noise["force"].size == pytest.approx(1e-3 * STRENGTH, rel=0.05)
    # What is left of the samples does not resolve the loops.
    assert noise_estimate(record.time, record["force"]) > 5 * record.noise["force"].size
    values, ones = record["force"][None], np.ones((1, len(record)))
    seen = prediction(("force",), np.zeros(len(record), dtype=int), [experiment], values)
    np.testing.assert_allclose(
        noise_sizes(seen, "force", declared=False), np.fmin(record.noise["force"].size, seen.sigma) * ones
    )
    np.testing.assert_allclose(largest_noise(seen, "force"), record.noise["force"].largest * ones)


def test_a_short_record_stays_as_it_is():
    experiment = Experiment("E01", record=long_record(3000))
    assert thinned(experiment, 4000) is experiment


def test_steps_longer_than_the_yield_elongation_are_divided():
    coarse = Record(
        np.arange(4), {"elongation": np.array([0.0, 0.5, -0.5, 0.0]), "force": np.array([0.0, 1, -1, 0]) * 1e5}
    )
    campaign = campaign_of(long_record())
    priors = {"A": Prior("lognormal", [np.log(2e7), 0.3]), "beta": Prior("lognormal", [np.log(200.0), 0.3])}
    naming = Naming((Element(law=BoucWen),), EFFECTS)
    (middle,), (steepest,) = (naming.laws((priors, {}), steepest=steepest) for steepest in (False, True))
    for record, longest in ((coarse, 1.0), (long_record(500), None)):
        longest = longest or np.abs(np.diff(record["elongation"])).max()
        grid = imposed_grid([record], characteristics(campaign), middle, steepest)
        step = np.max(np.abs(np.diff(record["elongation"])) / grid.divisions(record))
        assert grid.divisions(record).sum() <= grid.steps and step <= YIELD * 1.001
        assert longest > 20 * 0.2 * YIELD or step <= 0.2 * YIELD * 1.001
    # Where the first sample is far beyond yield, the data cannot tell it, and the model does.
    blind = characteristics(
        campaign_of(
            Record(
                np.arange(2001), {"elongation": 0.1 * np.sin(np.arange(2001)), "force": 1e5 * np.sin(np.arange(2001))}
            )
        )
    )
    assert imposed_grid([coarse], blind, middle, steepest).divisions(coarse).max() >= 200


def test_an_interval_of_a_larger_change_has_more_steps_and_samples_are_at_their_ends():
    elongation = np.array([0.0, 0.001, 0.002, 0.012, 0.022, 0.023, 0.024, 0.0236])
    record = Record(np.cumsum([0.0, 1, 1, 10, 10, 1, 1, 1]), {"elongation": elongation, "force": elongation})
    grid = Grid(10, 1, change=0.001, steps=63)
    # In one of the intervals beside the largest elongation it turns.
    np.testing.assert_array_equal(grid.divisions(record), [1, 1, 10, 10, 1, 1, 8])
    recorded = conditions_of(Experiment("E01", record=record), campaign_of(long_record()), grid, None).recorded
    np.testing.assert_array_equal(recorded.ends, [0, 1, 2, 12, 22, 23, 24, 32, 63, 63])
    lengths = np.asarray(recorded.step_length)
    assert np.count_nonzero(lengths) == 32 and lengths.sum() == pytest.approx(25.0)
    path = np.asarray(recorded.forcing.samples.elongation)
    np.testing.assert_allclose(path[::2][recorded.ends[:8]], elongation, atol=1e-15)


@pytest.mark.whole
def test_a_study_fits_and_predicts_the_samples_that_were_kept():
    campaign = campaign_of(long_record(3000))
    study = study_of(measurements={"samples": 300}, calibration={"sampler": "laplace", "starts": 1})
    fit = hx.calibrate(study, campaign)
    assert np.count_nonzero(fit.fit.data.weights, axis=1).max() <= 300
    thin = fit.train.experiments[0].record
    assert len(thin) <= 300 and fit.train.histories(0, "force")[0].size == len(thin)
    notes = hx.compare(fit).notes
    assert len([note for note in notes if "thinned from 150" in note]) == 2
    assert fit.map["A"] == pytest.approx(STRENGTH / YIELD, rel=0.05) and campaign["E01"].record is not thin
    # The report draws the measured record beside predictions of part of it.
    part = _predicted_part(campaign["E01"].record, {"before": {"time": thin.time}})
    assert part == thin


def test_time_and_memory_are_forecast_and_grow_with_the_steps():
    campaign = campaign_of(long_record())
    said = {}
    for samples in (1000, 28000):
        built = Built(study_of(measurements={"samples": samples}, steps=["calibrate", "compare", "diagnose"]), campaign)
        text = forecast(built.inference, campaign)
        found = re.fullmatch(
            r"2 experiments of (\d+) steps each: expect about (.*) on \d+ cores, .* and ([\d.]+) GB", text
        )
        assert found and int(found[1]) == built.simulation.timeline.steps
        said[samples] = float(found[3])
        notes = built.experiments.thinning_notes(campaign)
        assert [note.partition(" samples")[0] for note in notes] == (
            [] if samples > 1000 else ["E01 is thinned from 1501 to 137", "E02 is thinned from 26500 to 860"]
        )
    assert said[1000] < said[28000] < 5


def test_of_many_thinned_records_the_ones_that_lose_most_are_told():
    record = long_record()
    one = Experiment("E01", record=record)
    names = [f"E{number:02d}" for number in range(1, 7)]
    # The noise on one record is lost with its samples.
    force = record["force"] + 0.05 * np.ptp(record["force"]) * (-1.0) ** np.arange(ROWS)
    noisy = replace(record, channels={**record.channels, "force": force})
    experiments = tuple(replace(one, id=name, record=noisy if name == "E05" else record) for name in names)
    campaign = replace(campaign_of(record), experiments=experiments)
    notes = Built(study_of(measurements={"samples": 1000}), campaign).experiments.thinning_notes(campaign)
    assert len(notes) == 4 and any(note.startswith("E05 ") for note in notes)
    assert notes[-1] == "3 other records are thinned, too, and lose less"


def test_a_record_that_takes_more_steps_than_the_model_has_is_refused():
    record = Record(np.arange(3.0), {"elongation": np.array([0.0, 0.05, 0.0]), "force": np.zeros(3)})
    with pytest.raises(UserError, match="'E01': its record takes 100 steps, more than the 63"):
        conditions_of(Experiment("E01", record=record), campaign_of(long_record()), Grid(8, 1, 0.001, 63), None)
