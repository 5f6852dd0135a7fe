"""The search for a layout: design space, objective with its derivatives, constraints, restarts, history."""
