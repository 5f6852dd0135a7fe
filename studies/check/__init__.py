"""Is what a person hands to the commands sound, and plausible? Belongs here: a check that a command would make later,
and ranges of the usual."""
