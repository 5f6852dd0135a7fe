"""90 % intervals of predicted motions (docs/corrector.md). Belongs here: what calibrates a model's `Spread` on trials
that it was not fitted to, what judges it, and the band of a motion or a shape."""
