"""The search for a layout (`search`) and the fit to measurements (`fit`). Belongs here: what searches or fits with any
forward model. Files, reports and commands do not."""
