"""Plan experiments, calibrate a structural model against them, find the physical effect it lacks."""

from hsed_jax import backend

backend.configure()
