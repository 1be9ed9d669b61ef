"""From an excitation to a response: pure JAX, written for one experiment; no files, no configuration, no plots."""
