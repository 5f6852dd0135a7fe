"""Laws and constants of specimens on a bench."""
