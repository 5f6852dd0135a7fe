"""Measured trials as fits and evaluations take them: which trials and frames are used, and what is left out and why."""
