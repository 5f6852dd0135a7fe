"""What solves a step: conjugate gradients and their preconditioner."""
