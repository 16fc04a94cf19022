"""Tools that know nothing of robots, and the version of the package."""

__version__ = "0.1.0"
