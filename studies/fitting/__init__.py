"""Fits of a model to measured trials, as a calibration and a trace make them. Belongs here: the order of the fits,
their intervals, and what becomes of a fit; the fit itself is `optimize.fit`."""
