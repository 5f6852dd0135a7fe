"""The part that all kernels share: Taichi, its fields, vectors, transfers, and how they are compiled
(docs/lab/compiler.md)."""
