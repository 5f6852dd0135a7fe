"""Predictions of a model: motions on demand, and their errors beside measured trials. Belongs here: what puts simulator
and model together, and what asks them for motions that no search or fit needs.
"""
