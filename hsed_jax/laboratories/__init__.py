"""Where an experiment is performed."""
