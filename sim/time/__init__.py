"""Time integration: schemes, steps, schedules, and which case rides in which lane."""
