"""Measured clouds, meshes and recordings from other programs' files, read strictly. Belongs here: a reader for
another kind of cloud.
"""
