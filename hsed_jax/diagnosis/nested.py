r"""Fits of many nested models at once: bounded Levenberg–Marquardt, with the simulations of all fits in one batch.

All models are the same large model, with all but a few parameters held at their neutral values.  One compiled program therefore
serves every candidate, every start and every subset of the experiments.  Derivatives are finite differences, one simulation per
coordinate, which also detect an effect without a derivative at its neutral value (a gap, a stop).  While steps gain as much as
expected, each step instead updates the derivatives along its direction (Broyden 1965), without a simulation.  A fit that
continues where another one ended, with other errors or without some of the experiments, starts with the known derivatives.

A small batch takes as long as its slowest simulation, so the number of batches counts.  Each batch has what each fit needs next,
derivatives or a trial step.  Only the starts of one fit wait for one another, where the best of them are chosen.

$$\varphi(x) = \tfrac12\sum_{ij} w_{ij}\Big(\frac{y_{ij}-f_{ij}(\theta(x))}{\sigma_{ij}}\Big)^2 - \sum_k\log p(x_k),
  \qquad x_k\in[l_k,u_k]$$
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from hsed_jax.diagnosis.batch import Predictions, Selected
from hsed_jax.diagnosis.box import Box, quadratic_minimum
from hsed_jax.diagnosis.fit_state import FitState, Submodel, Target, Task
from hsed_jax.inference.watch import Watch, fingerprint

# Step of a finite difference, in coordinates of order one: larger than rounding errors, much smaller than the width of a prior.
_DIFFERENCE = 1e-4
# A fit ends if a step gains less than this many nats, or after this many steps; each step has at most this many trials.
_GAIN = 0.02
_MOST_STEPS, _MOST_TRIALS = 30, 6
# After each of these numbers of steps, only this many starts of one fit continue.
_RACE = {3: 2, 7: 1}
# A start is stopped if it is this many nats behind the best fit of its use and needs more than this many steps to catch up.
_BEHIND, _AS_MANY = 20.0, 50
# Curvature of a coordinate without information from data or prior; only its bounds limit such a coordinate.
_FLAT = 1e-6
# Largest change of a coordinate of order one in a step: the linearisation says little of points that are farther away.
_FAR = 3.0
# Number of derivatives that are in RAM at once, and largest number that is stored for one fit.
_NUMBERS, _KEPT = 2**24, 2**17
# Largest number of consecutive steps that update the derivatives; each has to gain this share of the expected gain.
_MENDED, _EXPECTED = 3, 0.3


_Request = tuple[np.ndarray, Submodel, np.ndarray, np.ndarray | None]
"""A point, its model, its experiments, and the number of samples of each experiment."""


class NestedModels:
    """A large model, most of whose parameters are held.

    Arguments:
        batch: predicts its outputs.
        box: coordinates of its parameters, in the order of the batch.
        neutral: θ at which every effect is absent, with any values of the law parameters, (P,).
        watch: receives the number of finished fits, and stores their results.
    """

    def __init__(self, batch: Predictions, box: Box, neutral: Float[np.ndarray, " P"], watch: Watch | None = None):
        self.batch, self.box, self._watch = batch, box, watch or Watch()
        self._neutral = neutral
        self.neutral = box.x(neutral)
        self._asked = 0

    def within(self, box: Box, batch: Predictions | None = None, watch: Watch | None = None) -> "NestedModels":
        """The same models with other priors, and with another batch if the parameters have another meaning."""
        return NestedModels(self.batch if batch is None else batch, box, self._neutral, watch)

    def of_experiments(self, rows: Int[np.ndarray, " r"]) -> "NestedModels":
        """The same models for some of the experiments, which are then numbered by their positions in `rows`."""
        return NestedModels(Selected(self.batch, rows), self.box, self._neutral, self._watch)

    def submodel(self, free: Int[np.ndarray, " p"], held: Mapping[int, float] | None = None) -> Submodel:
        """A submodel with some free coordinates, some parameters held at given values, and all others neutral."""
        # Parameters are held, not coordinates: no rounding then moves an absent effect away from its neutral value.
        theta = self._neutral.copy()
        for column, value in (held or {}).items():
            theta[column] = value
        return Submodel(free, theta)

    def predict(
        self, points: Sequence[tuple[np.ndarray, Submodel]], rows: Int[np.ndarray, " r"]
    ) -> tuple[Float[np.ndarray, "B r J"], Float[np.ndarray, "B r"]]:
        """Outputs of models at several points for the experiments in `rows`, and whether the simulations converged."""
        outputs, ok = self._run([(x, submodel, rows, None) for x, submodel in points])
        return np.stack(outputs), np.stack(ok)

    def point(self, known: Mapping[str, float]) -> Float[np.ndarray, " P"]:
        """x with known values of some parameters, by name, SI, and neutral values of the others, (P,)."""
        theta = self._neutral.copy()
        for name, value in known.items():
            theta[self.box.names.index(name)] = value
        return np.clip(self.box.x(theta), self.box.low, self.box.high)

    def theta(self, x: Float[np.ndarray, " P"], submodel: Submodel) -> Float[np.ndarray, " P"]:
        """θ of a model at a point: the free coordinates are those of x, the other parameters have their held values."""
        return submodel.told(self.box.theta(x))

    def fit(self, target: Target, tasks: Sequence[Task]) -> list[FitState]:
        """Make fits, all in parallel; fits that an earlier run has stored are not made again.

        Arguments:
            target: the data of the fits.
            tasks: the fits to make.

        Returns:
            The final fit states, in the order of the tasks.
        """
        if not tasks:
            return []
        # The name has the position in the search and the integers of the tasks, but not the starts: these differ in the last bit
        # between programs of one model, and a resumed search does not compile the same programs as the interrupted one.
        self._asked += 1
        whole = [[t.submodel.free, t.use, t.rivals] for t in tasks]
        name = f"states-{fingerprint(self._asked, self._neutral, target.values, whole)}"
        if (kept := self._watch.recall(name)) is not None:
            return self._again(target, tasks, kept)
        fits = self._descended(target, tasks)
        # Few arrays: a file of hundreds takes as long to write as a batch of simulations.
        points, *numbers = zip(*((f.x, f.cost, len(f.gradient), f.steps, f.trials) for f in fits), strict=True)
        slopes = [np.concatenate(part) for part in zip(*((f.gradient, f.hessian.ravel()) for f in fits), strict=True)]
        self._watch.keep(name, [np.stack(points), *map(np.asarray, numbers), *slopes])
        return fits

    def _again(self, target: Target, tasks: Sequence[Task], kept: Sequence[np.ndarray]) -> list[FitState]:
        """Fits from their stored results; only their predictions are simulated again, which is cheap compared with a fit."""
        points, costs, sizes, steps, trials, gradients, hessians = kept
        fits = [
            FitState(task.submodel, x, task.use, steps=int(made), trials=int(failed))
            for task, x, made, failed in zip(tasks, points, steps, trials, strict=True)
        ]
        tables = self._costs(target, [(f, f.x) for f in fits])[1]
        own = zip(np.split(gradients, np.cumsum(sizes)[:-1]), np.split(hessians, np.cumsum(sizes**2)[:-1]), strict=True)
        for one, cost, (gradient, hessian), predicted in zip(fits, costs, own, tables, strict=True):
            one.cost, one.predicted = float(cost), predicted
            one.gradient, one.hessian = gradient, hessian.reshape(len(gradient), len(gradient))
        return fits

    def _descended(self, target: Target, tasks: Sequence[Task]) -> list[FitState]:
        fits = [
            FitState(t.submodel, np.clip(t.start, self.box.low, self.box.high), t.use, races=t.rivals >= 0)
            for t in tasks
        ]
        known = [self._taken_over(target, one, task.known) for one, task in zip(fits, tasks, strict=True)]
        unknown = [one for one, is_known in zip(fits, known, strict=True) if not is_known]
        for one, cost, predicted in zip(unknown, *self._costs(target, [(f, f.x) for f in unknown]), strict=True):
            one.cost, one.predicted = cost, predicted
            one.done = not np.isfinite(cost)
        lead, races = _lead(fits), _races(fits, tasks)
        for one, task, is_known in zip(fits, tasks, known, strict=True):
            # With other errors, a fit may have nothing to gain at its start: the known derivatives show this.
            if is_known:
                gain = self._expected(one, self._step(one))
                one.done = task.stays or gain < _GAIN or _is_beaten(one, gain, lead)
        while not all(f.done for f in fits):
            self._watch.count(sum(f.done for f in fits), len(fits))
            waiting = _give_up(races)
            active, lead = [f for f in fits if not f.done and id(f) not in waiting], _lead(fits)
            for some in self._portions(target, active):
                self._advance(target, some, lead)
        for race in races:
            _keep_best(race, 1)
        ended = [f for f in fits if f.steps == _MOST_STEPS and f.mended and np.isfinite(f.cost)]
        for one in ended:
            one.mended = -1
        for some in self._portions(target, ended):
            self._advance(target, some, {})
        return fits

    def _taken_over(self, target: Target, fit: FitState, known: FitState | None) -> bool:
        """Start a fit with the predictions and derivatives of a known fit at the same point; False if there are none."""
        if known is None or not known.slopes.size or not np.array_equal(known.x, fit.x):
            return False
        fit.predicted, fit.slopes = np.zeros_like(target.values), known.slopes
        rows = target.rows(fit.use)
        fit.predicted[rows] = known.predicted[rows]
        fit.cost = self._cost(target, fit, fit.x, fit.predicted[rows])
        fit.mended = known.mended
        self._derive(target, fit)
        return True

    def _portions(self, target: Target, fits: list[FitState]) -> Iterator[list[FitState]]:
        """The fits in portions, so that only the derivatives of one portion need RAM."""
        size = max(1, _NUMBERS // (target.values.size * max((len(f.free) for f in fits), default=1)))
        for start in range(0, len(fits), size):
            yield fits[start : start + size]

    def _advance(self, target: Target, fits: list[FitState], lead: Mapping[int, float]) -> None:
        """One batch of simulations: derivatives for each fit without valid ones, a trial step for each other fit.

        Arguments:
            target: the data.
            fits: to advance.
            lead: the lowest cost of each use.
        """
        points = [self._differences(f) if f.mended < 0 else [self._step(f)] for f in fits]
        outputs, ok = self._run(
            [(x, f.submodel, *_asked(target, f.use)) for f, own in zip(fits, points, strict=True) for x in own]
        )
        place = 0
        for one, own in zip(fits, points, strict=True):
            of_one = slice(place, place + len(own))
            place += len(own)
            if one.mended < 0:
                self._linearise(target, one, own, outputs[of_one], ok[of_one])
            else:
                self._try(
                    target, one, own[0], *self._outcome(target, one, own[0], outputs[of_one][0], ok[of_one][0]), lead
                )

    def _try(
        self,
        target: Target,
        fit: FitState,
        x: np.ndarray,
        cost: float,
        predicted: np.ndarray,
        lead: Mapping[int, float],
    ) -> None:
        """Accept a trial step or reject it; end a fit that has converged, or that cannot catch up with `lead`."""
        gain, was_mended = fit.cost - cost, fit.mended > 0
        if gain > 0:
            is_settled = gain < _GAIN and not was_mended
            self._move(target, fit, x, cost, predicted, is_settled)
            fit.damping = max(fit.damping / 5, 1e-9)
            fit.steps, fit.trials = fit.steps + 1, 0
            fit.done = is_settled or fit.steps == _MOST_STEPS or _is_beaten(fit, gain, lead)
        elif was_mended:
            # The attempt counts as a step: updated derivatives that often fail are slow, too.
            fit.mended, fit.steps = -1, fit.steps + 1
            fit.done = fit.steps == _MOST_STEPS
        else:
            fit.damping = max(fit.damping * 8, 1e-3)
            fit.trials += 1
            # The step hardly changes the cost: the fit has converged.
            fit.done = fit.trials == _MOST_TRIALS or bool(np.isfinite(cost) and -gain < 1e-3 * _GAIN)

    def _move(
        self, target: Target, fit: FitState, x: np.ndarray, cost: float, predicted: np.ndarray, is_settled: bool
    ) -> None:
        """Move to a better point.  A step that gained enough of what was expected updates the derivatives along its direction; a
        settled fit updates only its gradient."""
        step, gain, change = (x - fit.x)[fit.free], fit.cost - cost, predicted - fit.predicted
        expected = self._expected(fit, x)
        fit.x, fit.cost, fit.predicted = x, cost, predicted
        if is_settled:
            fit.gradient = fit.gradient + fit.hessian @ step
            return
        is_as_expected = gain > max(_GAIN, _EXPECTED * expected)
        fit.mended = fit.mended + 1 if fit.slopes.size and is_as_expected and fit.mended < _MENDED else -1
        if fit.mended > 0:
            change = change - np.tensordot(step, fit.slopes, 1)
            fit.slopes = fit.slopes + (step / (step @ step))[:, None, None] * change
            self._derive(target, fit)

    def _expected(self, fit: FitState, x: np.ndarray) -> float:
        """The reduction of the cost from the fit to a point, as predicted by gradient and Hessian."""
        step = (x - fit.x)[fit.free]
        return -float(fit.gradient @ step + 0.5 * step @ fit.hessian @ step)

    def _derive(self, target: Target, fit: FitState) -> None:
        """Gradient and Gauss–Newton Hessian of φ from the derivatives of the predictions."""
        rows = target.rows(fit.use)
        jacobian = target.standardised(fit.use, rows, fit.slopes[:, rows]).reshape(len(fit.free), -1)
        residual = target.standardised(fit.use, rows, (fit.predicted - target.values)[rows])
        terms = self.box.terms(fit.x, fit.free)
        fit.gradient = jacobian @ residual.ravel() - terms.slope
        fit.hessian = jacobian @ jacobian.T + np.diag(terms.curvature)

    def _step(self, fit: FitState) -> Float[np.ndarray, " P"]:
        """The damped Gauss–Newton step within the bounds, of at most `_FAR` in each coordinate."""
        low, high, x = self.box.low[fit.free], self.box.high[fit.free], fit.x[fit.free]
        damped = fit.hessian + np.diag(fit.damping * np.diag(fit.hessian) + _FLAT)
        # A coordinate that goes so far stays there, and the others adapt to it.  If it were only cut off, they would fit to a
        # point that is not reached, and the cost would often rise.
        step, _ = quadratic_minimum(fit.gradient, damped, np.maximum(low - x, -_FAR), np.minimum(high - x, _FAR))
        full = fit.x.copy()
        full[fit.free] = np.clip(x + step, low, high)
        return full

    def _costs(
        self, target: Target, trials: Sequence[tuple[FitState, np.ndarray]]
    ) -> tuple[list[float], list[np.ndarray]]:
        """φ and predictions at trial points."""
        outputs, ok = self._run([(x, f.submodel, *_asked(target, f.use)) for f, x in trials])
        found = [self._outcome(target, *trial, *own) for trial, *own in zip(trials, outputs, ok, strict=True)]
        return [cost for cost, _ in found], [predicted for _, predicted in found]

    def _outcome(
        self,
        target: Target,
        fit: FitState,
        x: np.ndarray,
        outputs: Float[np.ndarray, "r J"],
        ok: Float[np.ndarray, " r"],
    ) -> tuple[float, np.ndarray]:
        """φ of a fit at a point, infinite if a simulation diverged, and the predictions there, (n, J)."""
        predicted = np.zeros_like(target.values)
        predicted[target.rows(fit.use)] = outputs
        return self._cost(target, fit, x, outputs) if ok.all() else np.inf, predicted

    def _cost(self, target: Target, fit: FitState, x: np.ndarray, outputs: Float[np.ndarray, "r J"]) -> float:
        """φ of a fit at a point with these outputs; infinite if it is not finite."""
        cost = float(target.misfit(fit.use, outputs) - self.box.log_density(x[None], fit.free).sum())
        return cost if np.isfinite(cost) else np.inf

    def _differences(self, fit: FitState) -> list[np.ndarray]:
        """The points of finite differences of a fit: forward, unless the step would cross the upper bound."""
        points = np.repeat(fit.x[None], len(fit.free), axis=0)
        signs = np.where(fit.x[fit.free] + _DIFFERENCE > self.box.high[fit.free], -1.0, 1.0)
        points[np.arange(len(fit.free)), fit.free] += signs * _DIFFERENCE
        return list(points)

    def _linearise(
        self,
        target: Target,
        fit: FitState,
        points: Sequence[np.ndarray],
        outputs: Sequence[Float[np.ndarray, "r J"]],
        ok: Sequence[Float[np.ndarray, " r"]],
    ) -> None:
        """Derivatives of a fit from its outputs at the points of the finite differences."""
        rows = target.rows(fit.use)
        fit.slopes = np.zeros((len(points), *target.values.shape))
        for slope, k, x, there, is_ok in zip(fit.slopes, fit.free, points, outputs, ok, strict=True):
            slope[rows] = np.where(is_ok[:, None] > 0, there - fit.predicted[rows], 0.0) / (x[k] - fit.x[k])
        self._derive(target, fit)
        fit.mended = 0
        if fit.slopes.size > _KEPT:
            fit.slopes = np.zeros((0, 0, 0))

    def _run(self, requests: Sequence[_Request]) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Outputs (r, J) and convergence flags (r,) of each request."""
        if not requests:
            return [], []
        free = self.box.theta(np.stack([x for x, *_ in requests]))
        thetas = [
            np.repeat(s.told(own)[None], len(rows), axis=0) for own, (_, s, rows, _) in zip(free, requests, strict=True)
        ]
        rows = [rows for *_, rows, _ in requests]
        samples = [samples for *_, samples in requests if samples is not None]
        asked = np.concatenate(samples) if len(samples) == len(requests) else None
        outputs, ok = self.batch(np.concatenate(thetas), np.concatenate(rows), asked)
        ends = np.cumsum([len(own) for own in rows])[:-1]
        return np.split(outputs, ends), np.split(ok, ends)


def _asked(target: Target, use: int) -> tuple[np.ndarray, np.ndarray | None]:
    """The experiments that have a weight in a use, and the number of samples of each."""
    rows = target.rows(use)
    return rows, target.samples_of(use, rows)


def _lead(fits: Sequence[FitState]) -> dict[int, float]:
    """The lowest cost of each use."""
    return {use: min(f.cost for f in fits if f.use == use) for use in {f.use for f in fits}}


def _is_beaten(fit: FitState, gain: float, lead: Mapping[int, float]) -> bool:
    """Whether a racing fit is far behind the lowest cost of its use and too slow to catch up, with this gain in each step."""
    behind = fit.cost - lead[fit.use]
    return fit.races and behind > _BEHIND and gain * _AS_MANY < behind


def _races(fits: Sequence[FitState], tasks: Sequence[Task]) -> list[list[FitState]]:
    """The starts of each fit that has several."""
    races: dict[int, list[FitState]] = {}
    for one, task in zip(fits, tasks, strict=True):
        if task.rivals >= 0:
            races.setdefault(task.rivals, []).append(one)
    return list(races.values())


def _give_up(races: Sequence[list[FitState]]) -> set[int]:
    """Stop the starts that are behind, as soon as all active starts of their fit have made the steps of a stage.

    Returns:
        The identities (`id`) of the starts that wait for others at a stage.
    """
    waiting: set[int] = set()
    for race in races:
        least = min((f.steps for f in race if not f.done), default=0)
        if least in _RACE:
            _keep_best(race, _RACE[least])
        waiting |= {id(f) for f in race if f.steps in _RACE and f.steps > least}
    return waiting


def _keep_best(race: Sequence[FitState], left: int) -> None:
    """Stop all starts of a fit, except the `left` ones with the lowest costs."""
    for one in sorted(race, key=lambda f: f.cost)[left:]:
        one.done, one.cost = True, np.inf
