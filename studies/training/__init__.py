"""Training a corrector on measured sets."""
