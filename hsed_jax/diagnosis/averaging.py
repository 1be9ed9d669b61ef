r"""Averages of predictions over explanations that are equally good, and the differences between these explanations.

Each explanation predicts a Gaussian, whose variance is that of its parameters.  The average has the mean and the variance of the
mixture of these Gaussians.  The variance between the explanations is a separate part:

$$\bar f = \sum_k w_k f_k,\qquad \operatorname{var} = \sum_k w_k\,\operatorname{var}_k + \sum_k w_k (f_k-\bar f)^2 .$$

The weights are the probabilities of the models by their scores (`hsed_jax.diagnosis.score`).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hsed_jax.criticism.prediction import Prediction
from hsed_jax.diagnosis.fits import Model
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.diagnosis.rivals import predictive, shares_of
from hsed_jax.diagnosis.search import Search


class Explanation(NamedTuple):
    """One of several sets of effects that are equally good.

    Attributes:
        effects: the names of the effects.
        weight: of its predictions in the average.
        error_test: as in a candidate (`hsed_jax.diagnosis.findings.Candidate`).
    """

    effects: list[str]
    weight: float
    error_test: float


class Averaged(NamedTuple):
    """Predictions averaged over explanations.

    Attributes:
        explanations: the explanations of the average, the named one first.
        train, test: predictions of the fitted and of the held-out experiments; the part `explanations` of their bands is the
            standard deviation between the explanations.
        error_test: error of the average on the held-out experiments; None without any.
        differ: by output, the largest difference between the explanations, among the candidate experiments or, without any,
            among the measured ones: the standard deviation `sd` between them (SI), its `share` of the RMS of the mean
            prediction over time, and the `inputs` (declared units) or the `experiment`.
    """

    explanations: list[Explanation]
    train: Prediction
    test: Prediction | None
    error_test: float | None
    differ: Mapping[str, Mapping[str, Any]]

    def summary(self) -> dict[str, Any]:
        """The key `diagnosis.averaged` of `summary.json`."""
        explanations = [
            {k: v for k, v in e._asdict().items() if not isinstance(v, float) or np.isfinite(v)}
            for e in self.explanations
        ]
        found: dict[str, Any] = {"explanations": explanations, "differ": dict(self.differ)}
        return found if self.error_test is None else found | {"error_test": self.error_test}

    @property
    def sentence(self) -> str:
        """The explanations of the average, and their largest difference."""
        of = ", ".join(f"{' + '.join(e.effects) or 'nothing'} ({e.weight:.0%})" for e in self.explanations)
        output, most = max(self.differ.items(), key=lambda item: item[1]["share"])
        inputs = most.get("inputs", {})
        where = ", ".join(f"{name} = {value:.4g}" for name, value in inputs.items()) or most.get("experiment", "")
        return (
            f"predictions average over {of}; they differ most in {output.replace('_', ' ')}, by {most['share']:.1%} (sd) of it "
            f"at {where}"
        )


def averaged(problem: Problem, search: Search, models: Sequence[Model]) -> Averaged:
    """Average predictions over models that are equally good.

    Arguments:
        problem: the measurements and the large model.
        search: the search that found the models.
        models: the explanations, the named one first.
    """
    rows = np.arange(problem.rows + len(problem.candidates))
    means, spreads, ok = (np.stack(each) for each in zip(*(_moments(problem, m, rows) for m in models), strict=True))
    weights = shares_of(models)
    shares = weights[:, None] * (ok > 0)
    shares = (shares / np.maximum(shares.sum(axis=0), 1e-300))[..., None]
    mean = np.sum(shares * means, axis=0)
    parts = {
        "parameters": np.sqrt(np.sum(shares * spreads**2, axis=0)),
        "explanations": np.sqrt(np.sum(shares * (means - mean) ** 2, axis=0)),
    }
    size = len(problem.train.values)
    train = _prediction(problem, search, slice(0, size), mean, parts, ok)
    test = None if problem.test is None else _prediction(problem, search, slice(size, problem.rows), mean, parts, ok)
    errors = search.unseen([m.effects for m in models])
    return Averaged(
        [Explanation(sorted(m.effects), float(w), e) for m, w, e in zip(models, weights, errors, strict=True)],
        train,
        test,
        None if test is None or problem.test is None else problem.test.error(test.predicted),
        _difference(problem, mean, parts["explanations"], (ok > 0).all(axis=0)),
    )


def _moments(problem: Problem, model: Model, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Prediction of a model, its sd from the parameters, (r, J), and whether its simulation converged, (r,)."""
    mean, spread, ok = predictive(problem.models, model.fit, rows)
    return mean, np.sqrt(np.sum(spread**2, axis=2)), ok


def _prediction(
    problem: Problem, search: Search, rows: slice, mean: np.ndarray, parts: Mapping[str, np.ndarray], ok: np.ndarray
) -> Prediction:
    """The average, as a prediction of measured experiments."""
    measured, experiments = problem.train, problem.experiments
    if rows.start:
        assert problem.test is not None
        measured, experiments = problem.test, problem.held_out
    sigma = np.where(measured.used, problem.sigma(search.standard.errors, mean[rows]), 1.0)
    own = {"noise": sigma, **{name: part[rows] for name, part in parts.items()}}
    sd = np.sqrt(sum(part**2 for part in own.values()))
    return Prediction(
        problem.outputs,
        measured.groups,
        experiments,
        measured.values,
        measured.used,
        mean[rows],
        mean[rows],
        sd,
        sigma,
        (ok > 0).any(axis=0)[rows],
        parts=own,
    )


def _difference(problem: Problem, mean: np.ndarray, between: np.ndarray, ok: np.ndarray) -> dict[str, dict[str, Any]]:
    """By output, the experiment in which the explanations differ most."""
    rows = np.arange(problem.rows, len(mean)) if len(mean) > problem.rows else np.arange(problem.rows)
    rows = rows[ok[rows]] if ok[rows].any() else rows
    found: dict[str, dict[str, Any]] = {}
    for number, output in enumerate(problem.outputs):
        own = problem.train.groups == number
        sd, size = (np.sqrt(np.mean(table[rows][:, own] ** 2, axis=1)) for table in (between, mean))
        share = sd / np.where(size > 0, size, 1.0)
        most = int(np.argmax(share))
        row = int(rows[most])
        made = (*problem.experiments, *problem.held_out)
        where = (
            {"experiment": made[row].id}
            if row < problem.rows
            else {"inputs": dict(problem.candidates[row - problem.rows])}
        )
        found[output] = {"sd": float(sd[most]), "share": float(share[most]), **where}
    return found
