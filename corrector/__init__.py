"""Correctors: they learned from measured motions what a simulator leaves out. `field` is numpy alone; the network of
the paper needs PyTorch. Belongs here: what is learned and how it predicts; trials and folds are in
`studies.training`."""
