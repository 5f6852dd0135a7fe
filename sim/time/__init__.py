"""Time integration: schemes, steps, schedules, and which case rides in which lane. Belongs here: when and by which rule
a motion goes on; forces do not."""
