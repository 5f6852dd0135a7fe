"""The search for a layout: design space, objective with its derivatives, constraints, restarts, history. Belongs here:
what searches or fits with any forward model. Files, reports and commands do not; the fit to measurements is
`optimize.fit`."""
