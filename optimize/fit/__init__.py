"""One inverse problem: which unknowns make the motions that were measured (docs/architecture.md).

Measured clouds and a forward model, unknowns with priors: a `FitProblem`. Bounded Gauss-Newton steps, from near
where frames balance, lead to a `Fit`: values, their joint covariance, residuals, and why it ended.
"""
