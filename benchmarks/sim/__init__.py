"""`make bench-sim`: what a motion costs, beside bounds and others; writes a part of docs/lab/simulator.md."""
