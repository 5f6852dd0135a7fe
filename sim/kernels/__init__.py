"""What all kernels share: Taichi, its fields, vectors, transfers."""
