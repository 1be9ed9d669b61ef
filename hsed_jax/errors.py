"""The one exception for what a user got wrong."""


class UserError(Exception):
    """A mistake in a study, a campaign or a command: one message that says what, where, and what is allowed.

    The command line prints the message alone and exits with status 2; from Python it is raised as it is.
    """
