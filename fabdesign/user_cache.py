"""Where results are kept that cost time and depend on nothing but what their name hashes."""

import os
from pathlib import Path


def user_cache(kind: str) -> Path:
    """The folder of one kind of result: in FABDESIGN_CACHE, else in the user's cache folder. It need not be there."""
    base = os.environ.get("FABDESIGN_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "fabdesign" / kind
