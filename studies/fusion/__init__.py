"""Depth sensors' clouds become a measurement set: cleaning, registration, faces, frames. Belongs here: what Open3D
does."""
