"""Motions, measured clouds and predictions side by side: a page, a picture, an animation, files for other programs.
Belongs here: a format that shows a motion, a file each."""
