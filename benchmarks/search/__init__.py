"""What the search reaches on targets of the virtual rig: `python -m benchmarks.search`."""
