"""Figures of the misfit between measured and predicted."""


def misfit_pictures(comparison, location, campaign):
    """None yet."""
    return iter(())
