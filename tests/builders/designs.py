"""A design of the paper's case that takes seconds."""

STUDY = {
    "study": "asked",
    "structure": {
        "masses": [8e3, 9e3],
        "springs": [{"between": ["ground", 1], "stiffness": 4e5}, {"between": [2, "ground"], "stiffness": 1e6}],
        "specimen": {"between": [1, 2]},
        "damping": {"modal": 0.05, "specimen_stiffness": 5e5},
    },
    "excitation": {"near_fault_pulse": {"V_P": "V_P", "T_P": "T_P"}, "duration": 4.0},
    "inputs": {"V_P": {"uniform": [1.5, 3.0], "unit": "m/s"}, "T_P": {"uniform": [0.5, 1.5], "unit": "s"}},
    "model": {"parameters": {"A": {"uniform": [2e5, 9e5]}, "beta": {"uniform": [0.5, 2.0]}, "gamma": 0.0, "n": 1.0}},
    "experiments": {
        "virtual": {
            "parameters": {"A": 5e5, "beta": 1.0, "gamma": 0.0, "n": 1.0},
            "effects": {"stiffness_degradation": {"eta": 2e-5}},
        }
    },
    "error": {"relative": 0.05},
    "design": {"initial": 3, "iterations": 6, "candidates": 256, "kriging": {"starts": 2}},
    "calibration": {"chains": 2, "step_warmup": 20, "step_draws": 20, "starts": 2},
    "steps": ["design", "calibrate"],
}
