"""How a command can end but for success and failure: by a user's mistake, or early, with the work kept."""


class UserError(ValueError):
    """Wrong input: one line that says what is wrong and how to mend it; the command exits with status 2."""


class RunStopped(Exception):
    """A run that ends before its last step, with its work kept: one line that says why and how to go on.

    Args:
        message: the line.
        status: the command's exit status: 1 where something failed, 128 + n for signal n.
    """

    def __init__(self, message: str, status: int):
        super().__init__(message)
        self.status = status
