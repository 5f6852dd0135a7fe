"""How files are read and written, whatever they hold: TOML by declared dataclasses, tables, npz, JSON. Belongs here:
what knows a format and no noun.
"""
