"""The Python interface: simulate, calibrate, compare, locate, diagnose, improve, sensitivity."""
