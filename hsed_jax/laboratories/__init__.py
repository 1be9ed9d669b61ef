"""Laboratories: they perform the experiments."""
