"""Texts from Jinja's templates, which lie beside the modules that fill them in."""

import functools
from pathlib import Path
from typing import Any

import jinja2

ROOT = Path(__file__).parents[1]


def render(template: str, **values: Any) -> str:
    """Return the text of a template with its values in their places.

    Args:
        template: its path from the package's folder. What goes into HTML or SVG is
            escaped.
        values: by the names that the template has for them; a name without a value is
            an error.
    """
    return _environment().get_template(template).render(values)


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(ROOT),
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
