"""Is what a person hands to the commands sound, and plausible?"""

from studies.check.files import inspect
from studies.check.findings import Findings

__all__ = ["Findings", "inspect"]
