"""A Bouc–Wen spring by Euler's method, independent of the package."""

import numpy as np

A, BETA = 2.0e7, 200.0  # strength 100 kN


def loop(time, elongation, A=A, beta=BETA, substeps=20):
    """Force of a Bouc–Wen spring (γ = 0, n = 1) under an imposed elongation, by Euler at fine steps."""
    force = np.zeros(time.size)
    for k in range(1, time.size):
        z, du = force[k - 1], (elongation[k] - elongation[k - 1]) / substeps
        for _ in range(substeps):
            z += A * du - beta * abs(du) * z
        force[k] = z
    return force
