"""Specimens on a bench: laws of muscles, strips, cylinders and actuators, fitted to records and evaluated. Belongs
here: a law that needs no cloth."""
