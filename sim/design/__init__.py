"""From a design to the numbers that the kernels take."""
