"""The one error a user's mistake raises: a line that says what is wrong and how to mend it."""


class UserError(ValueError):
    """Wrong input; the command line prints the message as one line and exits with status 2."""
