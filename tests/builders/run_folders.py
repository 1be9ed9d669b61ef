"""A run folder as a run leaves it, with hostile names in it."""

import json

import numpy as np
import xarray as xr
import yaml

from hsed_jax.measurements import Campaign, Experiment, Record, write_campaign
from hsed_jax.measurements.experiment import Channel
from hsed_jax.reporting import style

HOSTILE = "</script><script>alert('x')</script>"
IDS = ("E01", "E02", "T01")
ERRORS = {"before": {"E01": 0.30, "E02": 0.40, "T01": 0.35}, "after": {"E01": 0.05, "E02": 0.06, "T01": 0.055}}
SENTENCE = "missing is hardening: the error on experiments that were not fitted goes from 0.350 to 0.055"


def split_of(id):
    return "test" if id.startswith("T") else "train"


def record(number):
    time = np.linspace(0.0, 4.0, 81)
    elongation = 0.02 * (1 + number) * np.sin(2 * np.pi * time)
    return Record(time, {"elongation": elongation, "force": 1e6 * elongation + 50.0 * np.cos(9 * time)})


def campaign(inputs):
    units = {"V_P": "m/s", "T_P": "s"}
    experiments = tuple(
        Experiment(id, {n: 1.0 + 0.5 * i + 0.1 * j for j, n in enumerate(inputs)}, record=record(i), split=split_of(id))
        for i, id in enumerate(IDS)
    )
    channels = {
        "time": Channel("time", "s", "t"),
        "elongation": Channel("elongation", "mm", "du"),
        "force": Channel("force", "kN", "F"),
    }
    return Campaign(HOSTILE, "ground_motion", {n: units[n] for n in inputs}, channels, {}, experiments)


def comparison(errors):
    content = {"adequate": False, "p_value": 0.0, "worst": [], "notes": ["the force is what it is"]}
    for split in ("train", "test"):
        own = {id: e for id, e in errors.items() if split_of(id) == split}
        each = {
            id: {o: {"nrmse": e, "noise_floor": 0.05, "scale": 1.0} for o in ("elongation", "force")}
            for id, e in own.items()
        }
        size = float(np.sqrt(np.mean(np.square(list(own.values())))))
        per_output = {
            o: {"nrmse": size, "noise_floor": 0.05, "scale": s} for o, s in (("elongation", 0.02), ("force", 2e4))
        }
        content[split] = {"error": size, "noise_floor": 0.05, "per_output": per_output, "per_experiment": each}
    return content


def summary():
    posterior = {"A": {"mean": 5e5, "sd": 1e3, "q05": 4.98e5, "q95": 5.02e5, "ess_bulk": 900.0, "rhat": 1.001}}
    estimate = {"delta": {"mean": 0.3, "sd": 0.01, "q05": 0.28, "q95": 0.32, "unit": "1"}}
    before = comparison(ERRORS["before"])
    before["where"] = [{"sentence": "70 % of the squared error is after 2 s"}]
    candidate = {"effect": "hardening", "family": "post-yield", "probability": 0.9987, "log_evidence_gain": 800.0,
                 "score": {"gain": 812.5, "standard_error": 20.0},
                 "estimate": estimate, "error_train": 0.05, "error_test": 0.055}  # fmt: skip
    other = candidate | {"effect": "slip", "probability": 0.0013, "log_evidence_gain": 3.5}
    calibration = {"map": {"A": 5e5}, "posterior": posterior, "divergences": 3}
    diagnosis = {"verdict": "missing_effects", "sentence": SENTENCE, "effects": ["hardening"]}
    found = {"look_alikes": [["hardening", "slip"]], "next_experiment": {"V_P": 2.9}, "expected_log_bayes_factor": 4.2}
    steps = [
        {"effects": [], "error_train": 0.35, "error_test": 0.35},
        {"effects": ["hardening"], "error_train": 0.055, "error_test": 0.055},
    ]
    after = {"map": {"A": 5e5}, "posterior": posterior, "divergences": 0, "comparison": comparison(ERRORS["after"])}
    return {
        "study": "shown",
        "status": "complete",
        "calibration": calibration | {"warning": "3 divergent transitions (should be none)"},
        "comparison": before,
        "diagnosis": diagnosis | {"ranking": [candidate, other]} | found,
        "improvement": {"steps": steps, "noise_floor": 0.05} | after,
    }


def results():
    groups = {}
    for model, root in (("before", "predictions"), ("after", "predictions_improved")):
        for number, id in enumerate(IDS):
            measured, data = record(number), {}
            for name, values in measured.channels.items():
                size = ERRORS[model][id]
                predicted, sd = (1 + size) * values, np.full(81, 0.01 * np.ptp(values))
                about = {"measured": values, "predicted": predicted, "mean": predicted, "sd": sd}
                data |= {f"{name}_{kind}": ("time", column) for kind, column in about.items()}
            groups[f"{root}/{split_of(id)}/{id}"] = xr.Dataset(data, {"time": measured.time})
    return xr.DataTree.from_dict(groups)


def write(folder, inputs=("V_P", "T_P"), **changes):
    """A run folder as a run leaves it."""
    folder.mkdir()
    steps = ["calibrate", "compare", "diagnose", "improve"]
    model = {
        "spring": "bouc_wen",
        "parameters": {"A": {"uniform": [2e5, 9e5]}, "gamma": 0.0},
        "effects": {},
        "own_effects": [],
    }
    study = {
        "study": "shown", "seed": 0, "model": model, "observe": "histories", "steps": steps, "improve": {},
        "structure": {"masses": [8e3], "springs": [{"between": ["ground", 1], "stiffness": 4e5}],
                      "specimen": {"between": ["ground", 1]}, "damping": {"modal": 0.05, "specimen_stiffness": 5e5}},
        "inputs": {n: {"uniform": [1.0, 3.0], "unit": "s"} for n in inputs},
        "experiments": {"campaign": str(folder / "campaign")},
    }  # fmt: skip
    (folder / "study.yaml").write_text(yaml.safe_dump(study))
    (folder / "summary.json").write_text(json.dumps(summary() | changes))
    provenance = {"python": "3.12", "versions": {"hsed_jax": "0.1.0"}, "git": None, "seed": 0,
                  "machine": {"platform": HOSTILE, "processor": "x", "cores": 2}, "sessions": [{"start": "now"}]}  # fmt: skip
    (folder / "provenance.json").write_text(json.dumps(provenance))
    write_campaign(campaign(inputs), folder / "campaign")
    results().to_netcdf(folder / "results.nc", engine="h5netcdf")
    figure = style.new_figure(2.0)
    figure.subplots().plot([0, 1], [1, 0])
    style.save(style.Picture(figure, "A fall & <more>", "It falls."), folder / "figures", "error_fall")
    return folder
