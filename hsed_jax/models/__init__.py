"""Models that are no spring law: a function of the user's, or a program."""
