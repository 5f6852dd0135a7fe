"""Layouts side by side: how near a target so many muscles come, of which type, on which sides. Belongs here: what
divides time between searches; one search is `studies.layouts`."""
