"""Motions, measured clouds and predictions side by side: a page, a picture, an animation, files for other programs.
Belongs here: a format that shows a motion, a file each."""

from studies.view.items import Item, errors_in_words
from studies.view.page import render_page
from studies.view.write import KINDS, write_panels

__all__ = ["KINDS", "Item", "errors_in_words", "render_page", "write_panels"]
