"""The loop: choose a design, measure it, calibrate, trace, train, choose again (docs/loop.md). Belongs here: turns and
what is kept of them; each step is another study."""

from studies.loop.run import open_study

__all__ = ["open_study"]
