"""Models that are no spring law: a function of the user's own, or a program."""
