"""The solver of a step: conjugate gradients and their preconditioner. Belongs here: a part of the preconditioner, or
another solver; forces do not."""
