"""The one exception that a user is meant to read."""


class InputError(ValueError):
    """Bad input, said in one line: what came, where, and what was expected. The command line exits with 2."""


class SimulationError(RuntimeError):
    """Sound input whose motion could not be computed, said in one line. The command line exits with 1."""
