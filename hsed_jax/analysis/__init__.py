"""The sentence of the package in Python: simulate, calibrate, compare, locate, diagnose, improve, sensitivity."""
