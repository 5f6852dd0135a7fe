"""Surfaces, clouds and curves as numbers: distances, errors, noise, placement, regions of the cloth. Belongs here:
what measures or places shapes and reads no file.
"""
