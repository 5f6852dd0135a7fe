"""Pictures that stand in a page, as text."""

import base64
import io
import re

from matplotlib.figure import Figure


def svg_of(figure: Figure) -> str:
    """An SVG element; the same figure gives the same text."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.DOTALL)


def png_address(png: bytes) -> str:
    """A PNG as an address that an image element takes."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
