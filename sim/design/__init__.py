"""A design as the numbers that the kernels take: nodes, supports, loops, lacing, loading. Belongs here: what is
known before a kernel runs, in numpy."""
