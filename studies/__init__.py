"""Studies that a person runs: searches, fits, sweeps, reports. Belongs here: what puts a simulator, a model and files
together for one purpose, a room for each. A law, a solver or a file format does not."""
