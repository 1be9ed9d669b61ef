"""Where the model fails: virtual specimens with one known flaw each, made by NumPy, and the sentence that must name it."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import hsed_jax as hx
from hsed_jax.criticism.coordinates import Samples
from hsed_jax.criticism.locate import Place, _best_limit, _best_word, locate
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.inference.maximum import maximise
from hsed_jax.measurements import Campaign, Experiment, Record
from hsed_jax.measurements.turns import branches, half_cycles
from hsed_jax.physics.outputs import absorbed_energy
from hsed_jax.study.build import Built

# Strength A/β = 100 kN at a yield elongation of 5 mm; noise 1 % of the strength.
A, BETA, NOISE = 2.0e7, 200.0, 1.0e3


def bouc_wen(z, rate, energy, beta=BETA, stiffness=A, eta=0.0, nu=0.0, pinching=0.0, asymmetry=0.0):
    """dz/dt of Baber & Wen 1981 with the pinching of Foliente 1995; γ = 0, n = 1; eta, nu and pinching per joule."""
    strength = (1 + nu * energy) * (1 + asymmetry * np.sign(z))
    pinched = 1.0
    if pinching:
        depth = 0.9 * (1 - np.exp(-pinching * max(energy, 0.0)))
        place = z * np.sign(rate) * strength * beta / stiffness - 0.05
        pinched = 1 - depth * np.exp(-((place / (0.3 * (0.3 + depth))) ** 2))
    return pinched * (stiffness * rate - strength * beta * abs(rate) * z) / (1 + eta * energy)


def driven(time, elongation, viscous=0.0, substeps=8, **flaw):
    """Force under an imposed elongation, linear between its samples: the explicit midpoint rule at fine steps."""
    z, energy, force = 0.0, 0.0, np.zeros(time.size)
    for k in range(1, time.size):
        h = (time[k] - time[k - 1]) / substeps
        rate = (elongation[k] - elongation[k - 1]) / (time[k] - time[k - 1])
        for _ in range(substeps):
            middle = z + 0.5 * h * bouc_wen(z, rate, energy, **flaw)
            z, energy = z + h * bouc_wen(middle, rate, energy, **flaw), energy + h * middle * rate
        force[k] = z
    return force + viscous * np.gradient(elongation, time)


def shaken(time, ground, mass, stiffness, beta, damping, substeps=4, **flaw):
    """Elongation and force of one mass on the specimen: RK4 at fine steps, the ground linear between its samples."""
    c = 2 * damping * np.sqrt(stiffness * mass)
    y, out = np.zeros(4), np.zeros((time.size, 2))

    def rates(y, a):
        _, v, z, e = y
        return np.asarray([v, -(c * v + z) / mass - a, bouc_wen(z, v, e, beta, stiffness, **flaw), z * v])

    for k in range(1, time.size):
        h = (time[k] - time[k - 1]) / substeps
        a = np.linspace(ground[k - 1], ground[k], 2 * substeps + 1)
        for j in range(substeps):
            k1 = rates(y, a[2 * j])
            k2 = rates(y + h / 2 * k1, a[2 * j + 1])
            k3 = rates(y + h / 2 * k2, a[2 * j + 1])
            k4 = rates(y + h * k3, a[2 * j + 2])
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        out[k] = y[0], y[2]
    return out.T


def growing_cycles(frequency, start=0.0, cycles=10, largest=0.04, per_cycle=60):
    """Time and elongation of sinusoidal cycles with growing amplitude."""
    phase = np.arange(1, cycles * per_cycle + 1) / per_cycle
    amplitude = largest * np.ceil(phase - 1e-9) / cycles
    return start + phase / frequency, amplitude * np.sin(2 * np.pi * phase)


def loading(frequencies):
    """Growing cycles at one frequency after the other, starting at rest."""
    times, elongations = [np.zeros(1)], [np.zeros(1)]
    for frequency in frequencies:
        time, elongation = growing_cycles(frequency, times[-1][-1], cycles=10 // len(frequencies))
        times.append(time)
        elongations.append(elongation)
    time, elongation = np.concatenate(times), np.concatenate(elongations)
    length = 1 + 10 * 60  # one length for all, hence one compiled program
    rest = length - time.size
    return (
        np.append(time, time[-1] + 1.0 + np.arange(rest)),
        np.append(elongation, np.full(rest, elongation[-1])),
    )


def component_campaign(flaw, frequencies=(0.5,), has_time=True, seed=0):
    time, elongation = loading(frequencies)
    force = driven(time, elongation, **flaw) + NOISE * np.random.default_rng(seed).standard_normal(time.size)
    record = {"elongation": 1e3 * elongation, "force": force / 1e3}
    channels = {"elongation": "mm", "force": "kN"}
    if has_time:
        record, channels = {"time": time, **record}, {"time": "s", **channels}
    return Campaign.from_frames(records={"E01": record}, protocol="displacement", channels=channels)


def study_of(**changes):
    priors = {"A": {"lognormal": [np.log(A), 0.7]}, "beta": {"lognormal": [np.log(BETA), 0.7]}}
    return hx.load_study(
        {
            "study": "flaws",
            "model": {"parameters": {**priors, "gamma": 0.0, "n": 1.0}},
            "experiments": {"campaign": "nowhere"},
            "observe": "histories",
            "steps": ["calibrate", "compare"],
            **changes,
        }
    )


class Plain:
    """The plain Bouc–Wen model, fitted (MAP alone) to campaigns of one shape by one compiled program."""

    def __init__(self, study, campaign):
        self.built = Built(study, campaign)
        posterior = self.built.inference.posterior
        starts = posterior.starts(2)
        self._find = lambda data: maximise(posterior, data, starts)
        self._predict = jax.jit(
            lambda theta, data: posterior.predict(posterior.of_model(theta), data.conditions, data.count)
        )

    def __call__(self, campaign) -> Prediction:
        posterior, experiments = self.built.inference.posterior, campaign.train.experiments
        data = self.built.inference.data(campaign, experiments)
        theta = self._find(data).theta
        predicted, ok = (np.asarray(x) for x in self._predict(theta, data))
        sigma = np.asarray(posterior.sigma(theta, jax.numpy.asarray(predicted), jax.numpy.asarray(ok), data))
        used, measured = np.asarray(data.weights) > 0, np.asarray(data.values)
        groups = posterior.groups
        return Prediction(
            posterior.outputs, groups, experiments, measured, used, predicted, predicted, sigma, sigma, ok > 0
        )


@pytest.fixture(scope="module")
def plain():
    return Plain(study_of(), component_campaign({}))


def found(plain, campaign):
    location = locate(plain(campaign), campaign)
    assert location.places, "the misfit was found nowhere"
    return location


LATE = ("time", "cycle", "energy")


def says_strong(place, side):
    """Whether the model is too strong above the limit (`side` above), or too weak below it, which is the same flaw."""
    return place.bias > 0 if place.part == side else place.bias < 0


@pytest.mark.whole
def test_a_perfect_model_fails_nowhere(plain):
    campaign = component_campaign({})
    location = locate(plain(campaign), campaign)
    assert location.sentences == []
    assert "not concentrated" in repr(location)


@pytest.mark.parametrize("flaw", [{"eta": 4e-5}, {"nu": 2e-5}], ids=["stiffness", "strength"])
def test_degradation_is_found_late(plain, flaw):
    place = found(plain, component_campaign(flaw)).places[0]
    assert place.coordinate in LATE
    assert says_strong(place, "above")


def test_pinching_is_found_near_zero_force(plain):
    location = found(plain, component_campaign({"pinching": 1e-4}))
    place = location.places[0]
    assert (place.coordinate, place.part) == ("branch", "near zero")
    assert place.bias > 0.3
    assert "near zero force" in location.sentences[0] and "too strong there" in location.sentences[0]


def test_asymmetry_is_found_in_the_sign_of_the_force(plain):
    # ν is larger for positive force, so the specimen is weaker there than a symmetric model.
    location = found(plain, component_campaign({"asymmetry": 0.25}))
    place = location.places[0]
    assert place.coordinate == "sign of the force"
    assert (place.bias > 0) == (place.part == "positive")
    assert f"at {place.part} force" in location.sentences[0]


def test_viscous_damping_is_found_at_high_rates(plain):
    location = found(plain, component_campaign({"viscous": 1.5e5}, frequencies=(2.0, 0.1)))
    place = location.places[0]
    assert (place.coordinate, place.part) == ("speed", "above")
    assert place.bias < -0.3
    assert "elongation rates above" in location.sentences[0] and "too weak there" in location.sentences[0]


def test_rates_are_no_coordinate_where_all_cycles_take_as_long(plain):
    location = found(plain, component_campaign({"viscous": 1.5e5}))
    assert "speed" not in {place.coordinate for place in location.places}


def test_without_time_sentences_speak_of_rows(plain):
    campaign = component_campaign({"nu": 2e-5}, has_time=False)
    location = found(plain, campaign)
    units = {place.coordinate: place.unit for place in location.places}
    assert units["time"] == "row" and "speed" not in units
    assert any(" row " in sentence for sentence in location.sentences)
    assert not any(" s," in sentence for sentence in location.sentences)


def test_a_misfit_that_follows_the_motion_is_found_nowhere():
    # A record that is still for seven of ten seconds, and a model that is off by 12 % with a lag: 98 % of the error is late.
    time, experiments, parts = np.linspace(0.0, 10.0, 801), [], []
    random = np.random.default_rng(1)
    for number in range(3):
        force = 1e5 * np.sin(2 * np.pi * 3.1 * (time - 7.0)) * (time > 7.0)
        lagged = 1e5 * np.sin(2 * np.pi * 3.1 * (time - 7.0) - 0.12) * (time > 7.0)
        measured = force + 200 * random.standard_normal(time.size)
        experiments.append(Experiment(f"E{number}", record=Record(time, {"force": measured})))
        parts.append((measured, lagged))
    measured, predicted = (np.stack(table) for table in zip(*parts, strict=True))
    sigma = np.full(measured.shape, 200.0)
    prediction = Prediction(
        ("force",), np.zeros(time.size, int), tuple(experiments), measured, np.ones(measured.shape, bool),
        predicted, predicted, sigma, sigma, np.ones(3, bool),
    )  # fmt: skip
    campaign = Campaign.from_frames(protocol="ground_motion", channels={"time": "s", "force": "N"}, records={})
    assert "time" not in {place.coordinate for place in locate(prediction, campaign).places}


def test_the_flaw_is_found_whatever_the_noise(plain):
    firsts = {found(plain, component_campaign({"asymmetry": 0.25}, seed=seed)).places[0].part for seed in range(3)}
    assert len(firsts) == 1


def test_shares_of_a_place_are_those_of_the_samples(plain):
    location = found(plain, component_campaign({"nu": 2e-5}))
    samples = location.samples
    for place in location.places:
        if place.limit is None:
            continue
        values = samples.numbers[place.coordinate]
        inside = values > place.limit if place.part == "above" else values <= place.limit
        assert place.sample_share == pytest.approx(inside.mean())
        assert place.motion_share == pytest.approx(samples.expected[inside].sum())
        assert place.error_share == pytest.approx(samples.share[inside].sum())
        signed = samples.signed[inside]
        assert place.bias == pytest.approx(signed.mean() / np.sqrt(np.mean(signed**2)))
    assert samples.share.sum() == pytest.approx(1.0)
    informations = [place.information for place in location.places]
    assert informations == sorted(informations, reverse=True)


# --- coordinates -----------------------------------------------------------------------------------------------------


def test_half_cycles_end_at_the_turns_and_not_at_noise():
    phase = np.arange(0, 3 * 40 + 1) / 40
    turns = half_cycles(np.sin(2 * np.pi * phase))
    np.testing.assert_array_equal(turns, [0, 10, 30, 50, 70, 90, 110, 120])
    noisy = np.sin(2 * np.pi * phase) + 0.002 * np.random.default_rng(0).standard_normal(phase.size)
    assert np.abs(half_cycles(noisy) - turns).max() <= 1
    assert half_cycles(np.zeros(4)).tolist() == [0, 3]


def test_branches_of_a_known_loop():
    # A trapezoidal loop: 0 → 1, back to -1, on the half-cycle from 1 to -1 the force falls from 1 to -1 over half the way.
    u = np.concatenate([np.linspace(0, 1, 21), np.linspace(1, -1, 41)[1:], np.linspace(-1, 1, 41)[1:]])
    force = exact_trapezoid(u)
    names = branches(force, u)
    assert names[15] == "loading" and names[55] == "loading"
    assert names[22] == "reversal"  # 5 % of the way after the turn at 20
    assert names[26] == "unloading" and force[26] > 0  # against the motion
    assert names[30] == "near zero" and abs(force[30]) < 1e-9
    assert set(branches(np.ones(4), np.zeros(4))) <= {"loading", "reversal", "near zero", "unloading"}


def exact_trapezoid(u):
    """An elastic, perfectly plastic spring: stiffness 2, strength 1."""
    force = np.zeros(u.size)
    for k, du in enumerate(np.diff(u)):
        force[k + 1] = np.clip(force[k] + 2 * du, -1, 1)
    return force


def test_absorbed_energy_of_a_spring_is_half_stiffness_times_square():
    u = np.linspace(0, 0.1, 11)
    np.testing.assert_allclose(absorbed_energy(4e3 * u, u), 0.5 * 4e3 * u**2, atol=1e-12)


# --- over the inputs -------------------------------------------------------------------------------------------------


def quantities_prediction(off, count=24):
    """Peak force and energy of experiments over V_P; `off` gives the error of each as a function of V_P [m/s]."""
    random, V_P = np.random.default_rng(3), np.linspace(1.0, 3.0, count)
    experiments = tuple(Experiment(f"E{i:02d}", {"V_P": float(v)}) for i, v in enumerate(V_P))
    measured = np.stack([1e5 * V_P, 2e4 * V_P**2], axis=1)
    predicted = measured * (1 + off(V_P)[:, None] + 0.01 * random.standard_normal(measured.shape))
    sigma = 0.01 * measured
    prediction = Prediction(
        ("peak_force", "dissipated_energy"), np.arange(2), experiments, measured, np.ones_like(measured, dtype=bool),
        predicted, predicted, sigma, sigma, np.ones(count, dtype=bool),
    )  # fmt: skip
    campaign = Campaign.from_frames(
        protocol="ground_motion", inputs={"V_P": "cm/s"}, quantities={"peak_force": "kN", "dissipated_energy": "kJ"}
    )
    return prediction, campaign


def test_a_misfit_at_large_inputs_is_found_there_in_declared_units():
    location = locate(*quantities_prediction(lambda V_P: np.where(V_P > 2.4, 0.4, 0.0)))
    place = location.places[0]
    assert (place.coordinate, place.part, place.unit) == ("V_P", "above", "cm/s")
    assert place.limit == pytest.approx(240, abs=15)  # two experiments apart 8.7 cm/s
    assert "at V_P above" in location.sentences[0] and "cm/s" in location.sentences[0]
    assert "30 % of the measured values; the model is too strong there" in location.sentences[0].replace("29 %", "30 %")
    assert location.samples is None


def test_a_place_holds_more_of_the_error_than_its_share_of_the_motion():
    # A third of the samples is right, which tells most; a reader asks where the model is wrong.
    sizes = np.repeat([0.01, 1.0, 1.2], 30)
    signed = sizes * np.tile([1.0, -1.0], 45)
    share, even = signed**2 / (signed @ signed), np.full(90, 1 / 90)
    words = np.repeat(["right", "wrong", "worse"], 30)
    samples = Samples(share, even, signed, np.zeros(90, dtype=int), {"time": np.arange(90.0)}, {"part": words})
    place = _best_word("part", words, samples)
    assert place.part == "worse" and place.error_share > 1.5 * place.motion_share and place.is_concentrated
    late = _best_limit("time", "s", samples.numbers["time"], samples)
    assert late.part == "above" and late.error_share > late.motion_share


def test_the_larger_part_of_an_even_misfit_is_no_place():
    place = Place("time", "above", 2.0, "s", 0.97, 0.93, 0.95, 0.1, 0.1)
    assert not place.is_concentrated and not place.way
    assert replace(place, bias=0.8).way == "; the model is too strong there"


def test_a_misfit_of_noise_alone_is_found_nowhere():
    assert locate(*quantities_prediction(lambda V_P: 0 * V_P)).sentences == []


def test_one_experiment_of_quantities_has_no_place_and_no_warning():
    prediction, campaign = quantities_prediction(lambda V_P: 0.1 + 0 * V_P, count=1)
    assert locate(prediction, campaign).sentences == []


def test_the_experiment_that_differs_is_named():
    prediction, campaign = quantities_prediction(lambda V_P: np.where(np.abs(V_P - 2.0) < 0.03, 3.0, 0.0), count=11)
    location = locate(prediction, campaign)
    assert location.sentences[0].startswith("100 % of the squared error is in experiment E05")


# --- under ground motion ---------------------------------------------------------------------------------------------
# Only degradation is asked for here, and it proves less than above: pinching is placed at high absorbed energy as well, and
# asymmetry in the output elongation, whose drift under ground motion hides on which side the force is wrong.

MASS, STIFFNESS, SHAKEN_BETA, DAMPING = 2.0e4, 2.0e6, 40.0, 0.05


def shaking(seed, peak):
    """A ground motion: coloured noise around 1.5 Hz with an envelope that lasts."""
    time = np.arange(0, 16, 0.02)
    frequency = np.fft.rfftfreq(time.size, 0.02)
    colour = 1 / (1 - (frequency / 1.5) ** 2 + 0.9j * frequency / 1.5)
    white = np.fft.rfft(np.random.default_rng(seed).standard_normal(time.size))
    ground = np.fft.irfft(np.where(frequency > 0.2, white * colour, 0.0), time.size) * np.minimum(1, time / 2)
    return time, peak * ground / np.abs(ground).max()


def shaken_campaign(**flaw):
    random, records = np.random.default_rng(7), {}
    for number, peak in enumerate((2.0, 3.0)):
        time, ground = shaking(number, peak)
        elongation, force = shaken(time, ground, MASS, STIFFNESS, SHAKEN_BETA, DAMPING, **flaw)
        records[f"E{number + 1:02d}"] = {
            "time": time,
            "ground_acceleration": ground,
            "elongation": elongation + 2e-4 * random.standard_normal(time.size),
            "force": force + 500 * random.standard_normal(time.size),
        }
    channels = {"time": "s", "ground_acceleration": "m/s^2", "elongation": "m", "force": "N"}
    return Campaign.from_frames(records=records, protocol="ground_motion", channels=channels)


@pytest.fixture(scope="module")
def shaken_plain():
    structure = {
        "masses": [MASS],
        "springs": [],
        "specimen": {"between": ["ground", 1]},
        "damping": {"modal": DAMPING, "specimen_stiffness": STIFFNESS},
    }
    priors = {"A": {"lognormal": [np.log(STIFFNESS), 0.7]}, "beta": {"lognormal": [np.log(SHAKEN_BETA), 0.7]}}
    study = study_of(structure=structure, model={"parameters": {**priors, "gamma": 0.0, "n": 1.0}})
    return Plain(study, shaken_campaign())


@pytest.mark.whole
def test_a_perfect_model_fails_nowhere_under_ground_motion(shaken_plain):
    campaign = shaken_campaign()
    assert locate(shaken_plain(campaign), campaign).sentences == []


@pytest.mark.whole
@pytest.mark.parametrize("flaw", [{"eta": 1e-4}, {"nu": 1e-4}], ids=["stiffness", "strength"])
def test_degradation_is_found_late_under_ground_motion(shaken_plain, flaw):
    location = found(shaken_plain, shaken_campaign(**flaw))
    assert location.places[0].coordinate in LATE, location
    assert location.places[0].part == "above", location
