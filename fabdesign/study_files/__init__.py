"""The questions of a study: the kinds of `fabdesign.study/1` and their tables. Belongs here: a kind of study, or
a table that several kinds hold.
"""
