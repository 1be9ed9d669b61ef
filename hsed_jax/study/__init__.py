"""A study, built: the objects that compute, from what a user said."""
