r"""The places of the misfit, as a ranked list of plain sentences.

For every coordinate, the part of the data with the largest information about the size and the sign of the residual is found.
Only parts count whose share of the error exceeds their share of the motion.  Let p be the share of the squared error in a
part. q is the share of the samples or the share that a misfit in proportion to the motion would have there, whichever is
closer to p. R² is the share of the squared error that the two means of the signed residual (predicted minus measured, in the
direction of the measurement) inside and outside the part explain beyond their common mean. The part has the information

$$I = \tfrac12\Big[p\log\frac pq + (1-p)\log\frac{1-p}{1-q}\Big] - \tfrac12\log(1-R^2)$$

nats per sample. The first term is the divergence between the distribution of the error and that of samples and motion
(Kullback & Leibler 1951), halved because the information of a variance is half the logarithm of its factor. The second term
is the gain of a Gaussian likelihood from a separate mean.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hsed_jax.criticism.coordinates import UNITS, Samples, quantities_of, samples_of
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.measurements import Campaign
from hsed_jax.physics.display import shown_in
from hsed_jax.physics.outputs import output
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE, Pair
from hsed_jax.tables import Table, Tabular

_SMALLEST_PART = 0.05
_LEAST = 0.02
_CLEAR = 0.3
# Share of the squared error that a place has beyond its share of the motion.
_MORE = 0.05


@dataclass(frozen=True)
class Place:
    """A part of the data in which the misfit is concentrated, or has one sign.

    Attributes:
        coordinate: the coordinate that defines it: time, cycle, amplitude, energy, speed, branch, sign of the force, output,
            experiment, or the name of an input.
        part: `above` or `below` a limit, or the word.
        limit: in SI (inputs: declared unit); None for words.
        unit: of the limit; `row` of a time that is the row number.
        error_share: share of the squared error in it.
        sample_share: share of the samples in it.
        motion_share: share of the squared error that a misfit in proportion to the motion, beside the noise, would have in it; of
            quantities the share of the measured values.
        information: I, in nats per sample: its information.
        bias: mean of predicted minus measured in it, in the direction of the measurement, over the RMS residual of the
            part: 1 where the model is always too strong, -1 where it is always too weak.
        bias_elsewhere: the same of all other samples.
        of_force: whether the measured output has a strength, otherwise a size.
        items: the reference of an even misfit: the motion, or the measured values.
        pair: that the specimen was measured in.
    """

    coordinate: str
    part: str
    limit: float | None
    unit: str
    error_share: float
    sample_share: float
    motion_share: float
    information: float
    bias: float
    bias_elsewhere: float = 0.0
    of_force: bool = True
    items: str = "motion"
    pair: Pair = ELONGATION_AND_FORCE

    @property
    def sentence(self) -> str:
        """The place in plain words."""
        share = f"{100 * self.error_share:.0f} % of the squared error is {self._where}"
        return f"{share}, which holds {100 * self.motion_share:.0f} % of the {self.items}{self.way}"

    @property
    def is_concentrated(self) -> bool:
        """Whether its share of the error exceeds its share of the motion materially."""
        return self.error_share - self.motion_share >= _MORE

    @property
    def way(self) -> str:
        """The sign of the error of the model there, in words; empty if it is not clear."""
        there, elsewhere = self._too(self.bias), self._too(self.bias_elsewhere)
        if not there:
            return ""
        opposite = elsewhere and elsewhere != there
        return f"; the model is {there} there" + (f" and {elsewhere} elsewhere" if opposite else "")

    def _too(self, bias: float) -> str:
        """The sign of the error of the model, if it is clear."""
        strong, weak = ("strong", "weak") if self.of_force else ("large", "small")
        return "" if abs(bias) < _CLEAR else f"too {strong if bias > 0 else weak}"

    @property
    def _where(self) -> str:
        if self.limit is not None:
            if self.coordinate == "cycle":
                return f"{'after' if self.part == 'above' else 'up to'} cycle {self.limit:.0f}"
            if self.coordinate == "time":
                if self.unit == "row":
                    return f"{'after' if self.part == 'above' else 'up to'} row {self.limit:.0f}"
                return f"{'after' if self.part == 'above' else 'until'} {_plain(self.limit)} s"
            # An input is read in the unit it was declared in.
            is_input = self.coordinate not in UNITS
            divisor, unit = (1.0, self.unit) if is_input else shown_in(self.pair, UNITS[self.coordinate], self.limit)
            unit = "" if unit == "1" else unit.replace("^3", "³")
            name = {
                "energy": "an absorbed energy",
                "amplitude": self.pair.words("elongations"),
                "speed": f"{self.pair.elongation} rates",
            }.get(self.coordinate, self.coordinate)
            return f"at {name} {self.part} {_plain(self.limit / divisor)} {unit}".rstrip()
        templates = {
            "branch": {
                "loading": "on loading",
                "unloading": "on unloading",
                "reversal": "just after reversals",
                "near zero": f"near zero {self.pair.force}",
            },
            "sign of the force": {
                "positive": f"at positive {self.pair.force}",
                "negative": f"at negative {self.pair.force}",
            },
            "output": {self.part: f"in {self.pair.words(self.part)}"},
            "experiment": {self.part: f"in experiment {self.part}"},
        }
        return templates[self.coordinate][self.part]


def _plain(value: float) -> str:
    """Three digits, without an exponent for usual magnitudes."""
    text = f"{value:.3g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e7 else text


@dataclass(frozen=True, repr=False)
class Location(Tabular):
    """The places where a model fails, most informative first.

    Attributes:
        places: one per coordinate, ranked.
        samples: the samples behind the places; None if only quantities are observed.
    """

    places: list[Place]
    samples: Samples | None

    @property
    def sentences(self) -> list[str]:
        """The ranked list in plain words."""
        return [place.sentence for place in self.places]

    def summary(self) -> list[dict[str, Any]]:
        """The places as plain data."""
        return [
            {key: value for key, value in place.__dict__.items() if key != "pair"} | {"sentence": place.sentence}
            for place in self.places
        ]

    def _table(self) -> Table:
        rows = [
            (
                p._where,
                f"{100 * p.error_share:.0f} %",
                f"{100 * p.motion_share:.0f} %",
                p._too(p.bias) or "–",
                p._too(p.bias_elsewhere) or "–",
            )
            for p in self.places
        ]
        items = self.places[0].items if self.places else "motion"
        heads = ("where", "of the squared error", f"of the {items}", "model there", "model elsewhere")
        return Table(next(iter(self.sentences), "the misfit is not concentrated in any part of the data"), heads, rows)


def locate(prediction: Prediction, campaign: Campaign) -> Location:
    """Locate the misfit.

    Arguments:
        prediction: of the experiments to look at.
        campaign: of the experiments: its protocol, and the units of its inputs.
    """
    histories = prediction.groups.size > len(prediction.outputs)
    samples = samples_of(prediction, campaign) if histories else quantities_of(prediction)
    of_force = all(output(name).is_strength for name in prediction.outputs)
    found = [
        _best_limit(name, campaign.pair.unit(UNITS[name]), values, samples) for name, values in samples.numbers.items()
    ]
    found += [_best_word(name, words, samples) for name, words in samples.words.items()]
    for name in campaign.inputs:
        unit = campaign.unit(name)
        values = np.asarray(unit.from_si(np.asarray([e.inputs[name] for e in prediction.experiments])))
        found.append(_best_limit(name, unit.text, values[samples.experiment], samples))
    # The level that noise alone reaches, with some three hundred parts to choose from.
    least = max(_LEAST, (np.log(samples.share.size) + 3) / samples.share.size)
    found = [place for place in found if place is not None and (place.is_concentrated or place.way)]
    places = [
        replace(
            place,
            unit="row" if place.coordinate == "time" and not campaign.has_time else place.unit,
            of_force=of_force,
            items="motion" if histories else "measured values",
            pair=campaign.pair,
        )
        for place in found
        if place.information > least
    ]
    return Location(sorted(places, key=lambda place: -place.information), samples if histories else None)


def _best_limit(name: str, unit: str, values: np.ndarray, samples: Samples) -> Place | None:
    """The limit above or below which the residual differs most, over the twentieths of the coordinate."""
    known = np.isfinite(values)
    levels = np.unique(values[known])
    if levels.size < 2:
        return None
    # Between two values that occur, so that every sample is clearly on one side; whole numbers stay whole.
    limits = np.unique(np.quantile(values[known], np.linspace(0.0, 1.0, 21), method="inverted_cdf"))
    parts = [
        (word, limit, values > limit if word == "above" else known & (values <= limit))
        for limit in limits[:-1]
        for word in ("above", "below")
    ]
    return _best(name, unit, parts, known, samples)


def _best_word(name: str, words: np.ndarray, samples: Samples) -> Place | None:
    known = words != "unknown"
    return _best(name, "", [(str(word), None, words == word) for word in np.unique(words[known])], known, samples)


def _best(name: str, unit: str, parts: list, known: np.ndarray, samples: Samples) -> Place | None:
    """The part with the largest information. A part and its complement have the same information; the one with more
    than its share of error is taken.
    """
    signed = samples.signed[known]
    total, expected = float(signed @ signed), samples.expected[known]
    if total == 0:
        return None
    best = None
    for word, limit, everywhere in parts:
        inside = everywhere[known]
        q = float(inside.mean())
        if not _SMALLEST_PART <= q <= 1 - _SMALLEST_PART:
            continue
        one, other = signed[inside], signed[~inside]
        p, even = float(one @ one) / total, float(expected[inside].sum()) / float(expected.sum())
        if p <= even:
            continue  # its share of the motion is large, so it is not a place of the misfit
        explained = signed.size * q * (1 - q) * (one.mean() - other.mean()) ** 2 / total
        # A share that the samples or the motion explain is not a finding.
        where = min(_divergence(p, q), _divergence(p, even)) if p > q else 0.0
        # Rounded, because a part and its complement carry the same information.
        information = round(0.5 * where - 0.5 * float(np.log1p(-min(explained, 1 - 1e-12))), 9)
        if best is None or (information, p / even) > (best.information, best.error_share / best.motion_share):
            about = (p, q, even, information, _bias(one), _bias(other))
            best = Place(name, word, None if limit is None else float(limit), unit, *about)
    return best


def _divergence(p: float, q: float) -> float:
    """p log(p/q) + (1-p) log((1-p)/(1-q))."""
    p = min(max(p, 1e-12), 1 - 1e-12)
    return float(p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q)))


def _bias(signed: np.ndarray) -> float:
    size = float(np.sqrt(np.mean(signed**2)))
    return float(signed.mean()) / size if size > 0 else 0.0
