"""Models other than spring laws: a function of the user, or a program."""
