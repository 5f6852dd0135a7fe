"""The loop: choose a design, measure it, calibrate, trace, train, choose again (docs/loop.md)."""
