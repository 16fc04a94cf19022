"""Files that ship with the package: assets, and the templates beside its modules."""

import functools
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import jinja2

PACKAGE = Path(__file__).resolve().parents[1]


def asset_path(relative: str) -> Path:
    """Return the path of a shipped file, e.g. `asset_path("bp2_mjcf/bp2.xml")`.

    A checkout has the assets beside the package, an installed wheel within it.
    """
    installed = PACKAGE / "assets"
    return (installed if installed.is_dir() else PACKAGE.parent / "assets") / relative


def render(template: str, **values: object) -> str:
    """Return the text of a Jinja template with its values in their places.

    Args:
        template: its path from the package's folder. What goes into HTML or SVG is
            escaped.
        values: by the names that the template has for them; a name without a value is
            an error.
    """
    return _environment().get_template(template).render(values)


@functools.cache
def _environment() -> "jinja2.Environment":
    import jinja2  # only reports need it

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(PACKAGE),
        autoescape=jinja2.select_autoescape(("html", "svg")),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.policies["json.dumps_kwargs"] = {
        "separators": (",", ":"),
        "allow_nan": False,
    }
    return environment
