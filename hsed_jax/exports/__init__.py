"""Exports: a calibrated law as an OpenSees script, its parameters as a table."""
