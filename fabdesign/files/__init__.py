"""The program's own kinds of files, each beside the noun that it holds: designs, models, sets, motions, pressures,
benches. Belongs here: a reader or writer of one kind; what all kinds share is in `formats`.
"""
