"""A population of specimens: real coupons of steel, and simulated populations whose truth is known.

    python benchmarks/specimens.py [--only recovery population common independent gibbs] [--replications N] [--keep DIR]
                                   [--markdown]

The coupons are 24 cyclic tests of four bars (Carreno et al. 2020), one coupon a bar held out; the law is that of Menegotto and
Pinto. `population` lets stiffness, strength, hardening and sharpness vary by bar, `common` gives all bars the same, `independent`
calibrates each bar by itself. `gibbs` draws from the posterior of `population` by an adaptive Metropolis within Gibbs, the
treatment that was published, on the same simulator, compiled and batched, and starts it where `population` has its mode.
`recovery` simulates populations and asks how often intervals cover the truth. Results go to `specimens.json` beside this file,
from which `--markdown` prints the table; what takes long is kept in DIR and taken up again from there.
"""

import argparse
import json
import pickle
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).with_suffix(".json")
COUPONS = Path(__file__).resolve().parents[2] / "shared" / "data" / "steel_coupons"
VARYING = ("k", "F_y", "b", "R0")
STUDY = {
    "study": "coupons",
    "model": {
        "spring": "menegotto_pinto",
        "parameters": {
            "k": {"lognormal": [12.2, 0.1]},
            "F_y": {"lognormal": [6.17, 0.12]},
            "b": {"lognormal": [-4.6, 0.7]},
            "R0": {"uniform": [2.0, 25.0]},
            "cR1": {"uniform": [0.5, 0.97]},
            "cR2": {"uniform": [0.02, 1.5]},
            "a1": {"half_normal": 0.1},
            "a3": {"half_normal": 0.1},
        },
    },
    "observe": "histories",
    "channels": ["force"],
    # What the law leaves counts as error, beside the 1 % of a load cell.
    "error": {"relative": 0.01, "inflate": True},
    "steps": ["calibrate", "compare"],
}
# A population of small specimens: a Bouc-Wen law under one cyclic test each, 2 % of noise.
SPECIMENS, SAMPLES, NOISE = 8, 60, 0.02
CENTRE, SPREAD, BETA = 2.0e7, 0.12, 200.0
SWEEPS, CHAINS, HYPER = 2000, 4, 20


def coupon_study(levels, **sampling):
    import hsed_jax as hx

    study = {
        **STUDY,
        "experiments": {"campaign": str(COUPONS)},
        "calibration": {"starts": 1, "draws": 1500, **sampling},
    }
    study["model"] = {**STUDY["model"], **({"levels": {"bar": list(VARYING)}} if levels else {})}
    return hx.load_study(study)


def follower(folder):
    """Keeps what is reached in files."""
    from hsed_jax.inference.watch import Watch

    class Keeper(Watch):
        def keep(self, name, arrays):
            (folder / f"keep-{name}").write_bytes(pickle.dumps(list(arrays)))

        def recall(self, name):
            kept = folder / f"keep-{name}"
            return pickle.loads(kept.read_bytes()) if kept.exists() else None

        def report(self, what):
            print(f"  {what}", flush=True)

    folder.mkdir(parents=True, exist_ok=True)
    return Keeper()


def held_out(calibrations):
    """Error and share in the 90 % band over the held-out coupons of some calibrations together, and by coupon."""
    from hsed_jax.analysis.calibration import compare

    errors, covered, squares, power = {}, [], [], []
    for calibration in calibrations:
        prediction, split = calibration.test, compare(calibration).test
        errors |= {e.id: split.per_experiment[e.id]["force"]["nrmse"] for e in prediction.experiments}
        inside = np.abs(prediction.measured - prediction.mean) <= 1.645 * prediction.sd
        covered += inside[prediction.used].tolist()
        squares += (prediction.residual[prediction.used] ** 2).tolist()
        power += prediction.measured[prediction.used].tolist()
    error = float(np.sqrt(np.mean(squares)) / np.std(power))
    return {"error_test": error, "coverage_90": float(np.mean(covered)), "by_coupon": errors}


def calibrated(study, campaign, keep):
    from hsed_jax.analysis.calibration import calibrate_built
    from hsed_jax.study.build import Built

    wall, cpu = time.perf_counter(), time.process_time()
    found = calibrate_built(Built(study, campaign), campaign, watch=follower(keep))
    return found, {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}


def population(keep, seconds):
    """The population by NUTS."""
    from hsed_jax import read_campaign

    found, took = calibrated(coupon_study(levels=True), read_campaign(COUPONS), keep)
    fit = found.fit
    return {
        **held_out([found]),
        **took,
        "rhat": float(fit.convergence.rhat.max()),
        "ess_bulk": float(fit.convergence.ess_bulk.min()),
        "divergences": fit.convergence.divergences,
        "parameters": len(fit.posterior.names),
        "levels": fit.levels(),
    }


def common(keep, seconds):
    """All bars alike."""
    from hsed_jax import read_campaign

    found, took = calibrated(coupon_study(levels=False, sampler="laplace"), read_campaign(COUPONS), keep)
    return {**held_out([found]), **took}


def independent(keep, seconds):
    """Each bar by itself."""
    from hsed_jax import read_campaign

    campaign, fits, took = read_campaign(COUPONS), [], {"seconds": 0.0, "cpu_seconds": 0.0}
    for bar in dict.fromkeys(e.metadata["bar"] for e in campaign):
        own = replace(campaign, experiments=tuple(e for e in campaign if e.metadata["bar"] == bar))
        found, more = calibrated(coupon_study(levels=False, sampler="laplace"), own, keep)
        fits.append(found)
        took = {name: took[name] + more[name] for name in took}
    return {**held_out(fits), **took}


def draws_per_second(keep, seconds):
    """NUTS and a Metropolis within Gibbs from the same mode, both compiled before the clock starts, in CPU seconds."""
    import jax
    import jax.numpy as jnp

    from hsed_jax import read_campaign
    from hsed_jax.inference.likelihood import standardised_residual
    from hsed_jax.inference.nuts import convergence
    from hsed_jax.inference.sampling import draw
    from hsed_jax.inference.watch import Watch
    from hsed_jax.study.build import Built

    study = coupon_study(levels=True)
    campaign = read_campaign(COUPONS)
    fit = calibrated(study, campaign, keep)[0].fit
    posterior, data, maximum = fit.posterior, fit.data, fit.maximum
    settings = Built(study, campaign).inference.settings
    draw(posterior, data, maximum, jnp.asarray(0.8), jax.random.key(7), settings._replace(warmup=2, draws=12), Watch())
    cpu = time.process_time()
    chains = draw(posterior, data, maximum, jnp.asarray(0.8), jax.random.key(1), settings, Watch())
    took, judged = time.process_time() - cpu, convergence(chains)
    names = list(posterior.names)
    shown = [names.index(name) for name in posterior.reported]
    nuts = {
        "cpu_seconds": took,
        "ess_bulk": float(judged.ess_bulk[shown].min()),
        "rhat": float(judged.rhat[shown].max()),
    }

    @jax.jit
    def by_experiment(own):
        predicted, ok = posterior.predict(own, data.conditions, data.count)
        # The errors of histories do not depend on the parameters.
        z = (data.weights > 0) * (predicted - data.values) / posterior.sigma(maximum.theta, predicted, ok, data)
        return -0.5 * jnp.sum(standardised_residual(z, ok, data).reshape(z.shape) ** 2, axis=1)

    found = gibbs(posterior, data, maximum, by_experiment, seconds)
    nuts["ess_per_second"] = nuts["ess_bulk"] / nuts["cpu_seconds"]
    found["ess_per_second"] = found["ess_bulk"] / found["cpu_seconds"]
    return {"nuts": nuts, "gibbs": found, "ratio": nuts["ess_per_second"] / found["ess_per_second"]}


def gibbs(posterior, data, maximum, by_experiment, seconds):
    """Adaptive Metropolis (Haario, Saksman & Tamminen 2001) within Gibbs: each bar, what is common, and centres with spreads."""
    from arviz_stats.base.array import array_stats

    (level,) = posterior.population.levels
    names, columns = list(posterior.model_names), [v.column for v in level.varying]
    shared = [k for k in range(len(names)) if k not in columns]
    bar_of, rows = np.asarray(data.members)[:, 0], np.arange(len(data.members))
    priors = [posterior.priors[name] for name in names]
    spreads = [v.spread for v in level.varying]
    theta, covariance = np.asarray(maximum.theta), np.asarray(maximum.covariance)

    def tabulated(prior, is_log):
        grid = np.asarray(prior.quantile(np.linspace(1e-5, 1 - 1e-5, 4001)))
        height = np.asarray(prior.log_density(grid)) + (np.log(grid) if is_log else 0.0)
        at = np.log(grid) if is_log else grid
        return lambda x: np.interp(x, at, height, left=-np.inf, right=-np.inf)

    of_shared, of_centre = [tabulated(priors[k], True) for k in shared], [tabulated(priors[k], True) for k in columns]
    of_spread = [tabulated(s, True) for s in spreads]
    traces, cpu = [], time.process_time()
    for chain in range(CHAINS):
        random, began = np.random.default_rng(chain), time.process_time()
        first = posterior.population.first
        common_at = np.log(theta[shared])
        centre, spread = np.log(theta[columns]), np.log(theta[first : first + len(columns)])
        z = theta[first + len(columns) :].reshape(level.shape)
        bars = (centre[:, None] + np.exp(spread)[:, None] * z).T
        relative = covariance / np.outer(theta, theta)
        scale_shared = relative[np.ix_(shared, shared)]
        scale_bars = np.stack([relative[np.ix_(columns, columns)]] * len(level.members)) * 0.1
        factors = np.zeros(1 + len(level.members))

        def likelihood(common_at, bars):
            own = np.empty((len(rows), len(names)))
            own[:, shared], own[:, columns] = np.exp(common_at), np.exp(bars[bar_of])
            return np.asarray(by_experiment(own))

        def hyper(centre, spread, bars):
            residual = (bars - centre) / np.exp(spread)
            prior = sum(f(x) for f, x in zip(of_centre, centre, strict=True)) + sum(
                f(x) for f, x in zip(of_spread, spread, strict=True)
            )
            return prior - 0.5 * np.sum(residual**2) - len(bars) * np.sum(spread)

        here = likelihood(common_at, bars)
        trace, kept_shared, kept_bars = [], [common_at], [bars]
        for sweep in range(SWEEPS):
            if time.process_time() - began > seconds / CHAINS:
                break
            # Adaptation: the history's covariance, and the size by the acceptance.
            if sweep > 200 and sweep % 50 == 0:
                scale_shared = np.cov(np.stack(kept_shared), rowvar=False)
                scale_bars = np.stack([np.cov(np.stack(kept_bars)[:, m], rowvar=False) for m in range(len(bars))])
            rate = 1 / np.sqrt(1 + sweep)

            def jump(scale, factor, random=random):
                size = 2.38 / np.sqrt(len(scale)) * np.exp(factor)
                return random.multivariate_normal(np.zeros(len(scale)), size**2 * scale + 1e-12 * np.eye(len(scale)))

            trial = common_at + jump(scale_shared, factors[0])
            before, after = (sum(f(x) for f, x in zip(of_shared, at, strict=True)) for at in (common_at, trial))
            there = likelihood(trial, bars) if np.isfinite(after) else here
            chance = np.exp(min(there.sum() + after - here.sum() - before, 0.0)) if np.isfinite(after) else 0.0
            factors[0] += rate * (chance - 0.25)
            if random.uniform() < chance:
                common_at, here = trial, there
            # The bars are independent of one another, given what is common: one batch for all.
            moved = bars + np.stack([jump(s, f) for s, f in zip(scale_bars, factors[1:], strict=True)])
            there = likelihood(common_at, moved)
            for m in range(len(bars)):
                own = bar_of == m
                of_prior = [-0.5 * np.sum(((at[m] - centre) / np.exp(spread)) ** 2) for at in (bars, moved)]
                chance = np.exp(min((there - here)[own].sum() + of_prior[1] - of_prior[0], 0.0))
                factors[1 + m] += rate * (chance - 0.25)
                if random.uniform() < chance:
                    bars, here = bars.copy(), here.copy()
                    bars[m], here[own] = moved[m], there[own]
            # Centres and spreads ask for no simulation.
            for _ in range(HYPER):
                trial = (
                    centre + 0.5 * np.exp(spread) * random.standard_normal(len(centre)),
                    spread + 0.5 * random.standard_normal(len(spread)),
                )
                # The width of the step depends on where it starts.
                forth = -0.5 * np.sum(((trial[0] - centre) / np.exp(spread) / 0.5) ** 2) - np.sum(spread)
                back = -0.5 * np.sum(((trial[0] - centre) / np.exp(trial[1]) / 0.5) ** 2) - np.sum(trial[1])
                gain = hyper(*trial, bars) - hyper(centre, spread, bars) + back - forth
                if np.log(random.uniform()) < gain:
                    centre, spread = trial
            trace.append(np.concatenate([np.exp(common_at), np.exp(centre), np.exp(spread)]))
            kept_shared.append(common_at)
            kept_bars.append(bars)
        traces.append(np.stack(trace))
    length = min(map(len, traces))
    table = np.stack([t[length // 4 : length] for t in traces])
    ess = [float(array_stats.ess(table[..., k], chain_axis=0, draw_axis=1)) for k in range(table.shape[-1])]
    rhat = [float(array_stats.rhat(table[..., k], chain_axis=0, draw_axis=1)) for k in range(table.shape[-1])]
    return {"cpu_seconds": time.process_time() - cpu, "sweeps": length, "ess_bulk": min(ess), "rhat": max(rhat)}


def simulated(seed):
    """A campaign of small specimens, and the strength of each."""
    from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, Record

    random = np.random.default_rng(seed)
    own = CENTRE * np.exp(SPREAD * random.standard_normal(SPECIMENS))
    time_, experiments = np.linspace(0.0, 6.0, SAMPLES), []
    sigma = NOISE * CENTRE / BETA
    for number, A in enumerate(own):
        elongation = 0.02 * (0.3 + 0.12 * time_) * np.sin(2 * np.pi * (0.5 + 0.02 * number) * time_)
        force = _bouc_wen(elongation, A) + sigma * random.standard_normal(SAMPLES)
        record = Record(time_, {"elongation": elongation, "force": force})
        experiments.append(Experiment(f"S{number}", record=record, metadata={"specimen": f"S{number}"}))
    channels = {
        "time": Channel("time", "s"),
        "elongation": Channel("elongation", "m"),
        "force": Channel("force", "N", noise=Noise(absolute=sigma)),
    }
    return Campaign("specimens", "displacement", {}, channels, {}, tuple(experiments)), own


def _bouc_wen(elongation, A):
    """γ = 0, n = 1 between samples of the spline that the package draws: z relaxes to ±A/β over the way, exactly."""
    from scipy.interpolate import CubicSpline

    grid = np.arange(len(elongation), dtype=float)
    dense = np.linspace(0, len(elongation) - 1, 40 * (len(elongation) - 1) + 1)
    way, z, found = np.diff(CubicSpline(grid, elongation)(dense), prepend=elongation[0]), 0.0, []
    for step in way:
        limit = np.sign(step) * A / BETA
        z = limit + (z - limit) * np.exp(-BETA * abs(step))
        found.append(z)
    return np.asarray(found)[::40]


def recovery(replications):
    """How often 90 % intervals of centre, spread and members cover the truth."""
    import hsed_jax as hx
    from hsed_jax.study.build import Built

    study = hx.load_study(
        {
            "study": "specimens",
            "model": {
                "parameters": {
                    "A": {"lognormal": [np.log(CENTRE), 0.3]},
                    "beta": {"lognormal": [np.log(BETA), 0.2]},
                    "gamma": 0.0,
                    "n": 1.0,
                },
                "levels": {"specimen": ["A"]},
            },
            "experiments": {"campaign": "nowhere"},
            "observe": "histories",
            "channels": ["force"],
            "steps": ["calibrate"],
            "calibration": {"starts": 1, "chains": 2, "warmup": 100, "draws": 300},
        }
    )
    from hsed_jax.analysis.calibration import calibrate_built

    inside = {"mean": [], "spread": [], "specimen": []}
    cpu = time.process_time()
    for seed in range(replications):
        campaign, own = simulated(seed)
        levels = calibrate_built(Built(study, campaign), campaign).fit.levels()["specimen"]["A"]
        covers = lambda told, truth: bool(told["q05"] <= truth <= told["q95"])  # noqa: E731
        inside["mean"].append(covers(levels["mean"], CENTRE))
        inside["spread"].append(covers(levels["spread"], SPREAD))
        inside["specimen"] += [covers(levels["of"][f"S{k}"], A) for k, A in enumerate(own)]
        if (seed + 1) % 10 == 0:
            print(seed + 1, {k: round(float(np.mean(v)), 3) for k, v in inside.items()}, flush=True)
    return {
        "replications": replications,
        "coverage": {k: float(np.mean(v)) for k, v in inside.items()},
        "cpu_seconds": time.process_time() - cpu,
    }


PARTS = {"population": population, "common": common, "independent": independent, "gibbs": draws_per_second}


def markdown(results):
    lines = ["| fit | error of held-out coupons | in the 90 % band | CPU seconds |", "|---|---|---|---|"]
    for part in ("population", "independent", "common"):
        if part in results:
            r = results[part]
            lines.append(f"| {part} | {r['error_test']:.4f} | {r['coverage_90']:.1%} | {r['cpu_seconds']:.0f} |")
    if "gibbs" in results:
        lines += [
            "",
            "| sampler | CPU seconds | least bulk ESS | largest R-hat | ESS per CPU second |",
            "|---|---|---|---|---|",
        ]
        for name in ("nuts", "gibbs"):
            r = results["gibbs"][name]
            numbers = f"{r['cpu_seconds']:.0f} | {r['ess_bulk']:.0f} | {r['rhat']:.3f} | {r['ess_per_second']:.3g}"
            lines.append(f"| {name} | {numbers} |")
    if "recovery" in results:
        r = results["recovery"]
        lines += ["", f"| 90 % interval of | covers, of {r['replications']} populations |", "|---|---|"]
        lines += [f"| {name} | {share:.1%} |" for name, share in r["coverage"].items()]
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=[*PARTS, "recovery"], default=[*PARTS, "recovery"])
    parser.add_argument("--replications", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=600.0, help="budget of the Metropolis within Gibbs [CPU s]")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "hsed_specimens")
    parser.add_argument("--markdown", action="store_true")
    options = parser.parse_args()
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if not options.markdown:
        for part in options.only:
            print(part, flush=True)
            made = recovery(options.replications) if part == "recovery" else PARTS[part](options.keep, options.seconds)
            results[part] = made
            RESULTS.write_text(json.dumps(results, indent=1) + "\n")
    print(markdown(results))


if __name__ == "__main__":
    main()
