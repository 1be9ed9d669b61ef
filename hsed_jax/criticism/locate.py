r"""Where the misfit lives, as a ranked list of plain sentences.

For every coordinate the part of the data is sought that holds most more of the squared error than its size explains.  With p the
share of the squared error in a part and q the share of the samples, the part is ranked by

$$D = p\log\frac pq + (1-p)\log\frac{1-p}{1-q}$$

(Kullback & Leibler 1951): the information that knowing the part gives about where the error is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from hsed_jax.criticism.coordinates import UNITS, Samples, samples_of
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.measurements import Campaign

_READABLE = {"J": ("kJ", 1e-3), "m": ("mm", 1e3), "s": ("s", 1.0), "m/s": ("mm/s", 1e3), "1": ("", 1.0)}
_SMALLEST_PART = 0.05


@dataclass(frozen=True)
class Place:
    """A part of the data in which the misfit is concentrated.

    Attributes:
        coordinate: what separates it: time, cycle, amplitude, energy, speed, branch, sign of the force, output, experiment,
            or the name of an input.
        part: `above` or `below` a limit, or the word.
        limit: in SI (inputs: declared unit); None for words.
        unit: of the limit.
        error_share: share of the squared error in it.
        sample_share: share of the samples in it.
        information: D, in nats: how concentrated.
        bias: mean of predicted less measured in it, times the sign of the force where that is known, over the output's
            RMS: positive where the model is too strong.
    """

    coordinate: str
    part: str
    limit: float | None
    unit: str
    error_share: float
    sample_share: float
    information: float
    bias: float

    @property
    def sentence(self) -> str:
        """The place in plain words."""
        share = f"{100 * self.error_share:.0f} % of the squared error is {self._where}"
        return f"{share}, which holds {100 * self.sample_share:.0f} % of the samples"

    @property
    def _where(self) -> str:
        if self.limit is not None:
            unit, factor = _READABLE.get(self.unit, (self.unit, 1.0))
            name = {"energy": "absorbed energy", "amplitude": "elongations", "speed": "elongation rates"}.get(
                self.coordinate, self.coordinate
            )
            return f"at {name} {self.part} {self.limit * factor:.3g} {unit}".rstrip()
        templates = {
            "branch": {
                "loading": "on loading",
                "unloading": "on unloading",
                "reversal": "just after reversals",
                "near zero": "near zero force",
            },
            "sign of the force": {"positive": "at positive force", "negative": "at negative force"},
            "output": {self.part: f"in {self.part}"},
            "experiment": {self.part: f"in experiment {self.part}"},
        }
        return templates[self.coordinate][self.part]


@dataclass(frozen=True)
class Location:
    """Where a model fails, most informative place first.

    Attributes:
        places: one per coordinate, ranked.
        samples: what the places were found in; None where only quantities were observed.
    """

    places: list[Place]
    samples: Samples | None

    @property
    def sentences(self) -> list[str]:
        """The ranked list in plain words."""
        return [place.sentence for place in self.places]

    def summary(self) -> list[dict[str, Any]]:
        """The places as plain data."""
        return [{**place.__dict__, "sentence": place.sentence} for place in self.places]

    def __repr__(self) -> str:
        return (
            "\n".join(f"{i + 1}. {sentence}" for i, sentence in enumerate(self.sentences))
            or "the misfit is nowhere in particular"
        )

    def _repr_html_(self) -> str:
        from html import escape

        return "<ol>" + "".join(f"<li>{escape(sentence)}</li>" for sentence in self.sentences) + "</ol>"


def locate(prediction: Prediction, campaign: Campaign) -> Location:
    """Find where the misfit lives.

    Arguments:
        prediction: of the experiments to look at.
        campaign: where they come from: its protocol, and the units of its inputs.
    """
    histories = prediction.groups.size > len(prediction.outputs)
    if histories:
        samples = samples_of(prediction, campaign)
        share, row = samples.share, samples.experiment
        places = [_best_limit(name, UNITS[name], values, samples) for name, values in samples.numbers.items()]
        places += [_best_word(name, words, samples) for name, words in samples.words.items()]
    else:
        samples = None
        scale = np.where(prediction.used, prediction.measured, np.nan)
        squares = (prediction.residual / np.nanstd(scale, axis=0)) ** 2
        share = squares.sum(axis=1) / max(float(squares.sum()), 1e-300)
        row = np.arange(len(prediction.experiments))
        places = []
    table = _flat(share, row)
    for name in campaign.inputs:
        unit = campaign.unit(name)
        values = np.asarray([e.inputs[name] for e in prediction.experiments])[row]
        if np.ptp(values) > 0:
            places.append(
                _best_limit(name, unit.text, np.asarray(unit.from_si(values)), table if samples is None else samples)
            )
    found = [place for place in places if place is not None and place.information > 0.02]
    return Location(sorted(found, key=lambda place: -place.information), samples)


def _flat(share: np.ndarray, row: np.ndarray) -> Samples:
    return Samples(share, np.zeros(share.size), row, {}, {})


def _information(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """D for shares p, q; negative where the part holds less error than its size explains."""
    p, q = np.clip(p, 1e-12, 1 - 1e-12), np.clip(q, 1e-12, 1 - 1e-12)
    return np.where(p > q, p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q)), -1.0)


def _best_limit(name: str, unit: str, values: np.ndarray, samples: Samples) -> Place | None:
    """The limit above or below which the error is concentrated most, over the deciles of the coordinate."""
    known = np.isfinite(values)
    if known.sum() < 4:
        return None
    values, share = values[known].astype(float), samples.share[known] / max(float(samples.share[known].sum()), 1e-300)
    best = None
    for limit in np.unique(np.quantile(values, np.linspace(0.05, 0.95, 19))):
        for part, inside in (("above", values > limit), ("below", values < limit)):
            q = float(inside.mean())
            if not _SMALLEST_PART <= q <= 1 - _SMALLEST_PART:
                continue
            p = float(share[inside].sum())
            d = float(_information(np.asarray(p), np.asarray(q)))
            if best is None or d > best.information:
                best = Place(name, part, float(limit), unit, p, q, d, _bias(samples, known, inside))
    return best


def _best_word(name: str, words: np.ndarray, samples: Samples) -> Place | None:
    best = None
    everything = np.ones(words.size, dtype=bool)
    for word in np.unique(words):
        inside = words == word
        q = float(inside.mean())
        if word == "unknown" or q > 1 - _SMALLEST_PART:
            continue
        p = float(samples.share[inside].sum())
        d = float(_information(np.asarray(p), np.asarray(q)))
        if best is None or d > best.information:
            best = Place(name, str(word), None, "", p, q, d, _bias(samples, everything, inside))
    return best


def _bias(samples: Samples, known: np.ndarray, inside: np.ndarray) -> float:
    sign = samples.words.get("sign of the force")
    towards = np.ones(samples.signed.size) if sign is None else np.where(sign == "negative", -1.0, 1.0)
    return float(np.mean((samples.signed * towards)[known][inside]))
