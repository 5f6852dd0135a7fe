"""Is what a person hands to the commands sound, and plausible? Belongs here: a check that a command would make later,
and ranges of the usual."""

from studies.check.files import fabric_of, inspect
from studies.check.findings import Findings

__all__ = ["Findings", "fabric_of", "inspect"]
