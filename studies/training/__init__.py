"""Training a corrector on measured sets (docs/corrector.md). Belongs here: trials, motions and folds; what is learned
is `corrector`."""
