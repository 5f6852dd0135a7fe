"""The demo's measured set, as a section of its page."""

from importlib.resources import files

from jinja2 import Environment

from studies.demo.measured import MADE_BY, MODEL, ShippedErrors


def as_html(shipped: ShippedErrors) -> str:
    """HTML, for the body of a page with the style of a study's report."""
    source = files("studies.demo").joinpath("measured.html.j2").read_text(encoding="utf-8")
    template = Environment(autoescape=True).from_string(source)
    return template.render(
        shipped=shipped,
        rows=shipped.rows(),
        made_by=MADE_BY,
        model=MODEL,
        mm=lambda metres: f"{1e3 * metres:.2f}",
        percent=lambda share: "" if share is None else f"{share:.0%}",
    )
