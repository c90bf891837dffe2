"""Texts rendered from viewnet/estimator/templates. jinja2 is imported when one is rendered: predicting needs none."""

from functools import cache
from typing import Any


def rendered(name: str, **values: Any) -> str:
    """The text of a template. HTML and SVG have their values escaped, and the indents and ends of lines removed."""
    text: str = _environment().get_template(name).render(values)
    return text if name.endswith(".md") else "".join(line.strip() for line in text.splitlines())


@cache
def _environment() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("viewnet.estimator"),
        autoescape=jinja2.select_autoescape(["html", "svg"]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["tenths"] = "{:.1f}".format
    return environment
