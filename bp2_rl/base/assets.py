"""Where the files that ship with the package lie: in a checkout, and in an installed
wheel."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def asset_path(relative: str) -> Path:
    """Path of a shipped file, e.g. `asset_path("bp2_mjcf/bp2.xml")`; the wheel carries
    assets inside the package."""
    installed = _PACKAGE / "assets"
    return (installed if installed.is_dir() else _PACKAGE.parent / "assets") / relative
