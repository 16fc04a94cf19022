"""How a command refuses a user's mistake."""


def is_told(error: str) -> bool:
    """Whether standard error tells a mistake: in one line of ours, or, of a flag that
    cannot be read, in tyro's words."""
    one_line = error.startswith("error: ") and error.count("\n") == 1
    return one_line or ("error: " not in error and "Traceback" not in error)
