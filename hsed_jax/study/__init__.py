"""A study, built: the objects that compute, made from the user's file."""
