"""`make demo`: two searches on an embedded cloud, and what an embedded measured set says of the shipped model."""
