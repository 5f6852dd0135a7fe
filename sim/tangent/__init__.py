"""Derivatives of converged shapes and motions: the exact tangent of the forces, and what is solved with it. Belongs
here: a Jacobian of what the simulator gives."""
