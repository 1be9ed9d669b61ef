"""A small study of the paper's case, as text and as a mapping."""

import yaml

from hsed_jax.config.load import parse_yaml

SMALL = """
study: small
seed: 3
structure:
  masses: [8.0e3, 9.0e3]
  springs: [{between: [ground, 1], stiffness: 4.0e5}, {between: [2, ground], stiffness: 1.0e6}]
  specimen: {between: [1, 2]}
  damping: {modal: 0.05, specimen_stiffness: 5.0e5}
excitation:
  near_fault_pulse: {V_P: V_P, T_P: T_P}
  duration: 10.0
inputs:
  V_P: {uniform: [1.5, 3.0], unit: m/s}
  T_P: {uniform: [0.5, 1.5], unit: s}
model:
  parameters: {A: {uniform: [2.0e5, 9.0e5]}, beta: {uniform: [0.5, 2.0]}, gamma: 0.0, n: 1.0}
experiments:
  virtual:
    parameters: {A: 5.0e5, beta: 1.0, gamma: 0.0, n: 1.0}
    effects: {stiffness_degradation: {eta: 2.0e-5}}
error: {relative: 0.05}
design: {initial: 3, iterations: 3, candidates: 256}
calibration: {chains: 2, warmup: 20, draws: 40, step_warmup: 10, step_draws: 10}
"""


def content(**changes) -> dict:
    """The study as a mapping, with other values of some of its keys."""
    return {**parse_yaml(SMALL, "small"), **changes}


def text(**changes) -> str:
    """The same as YAML."""
    return yaml.safe_dump(content(**changes), sort_keys=False)
