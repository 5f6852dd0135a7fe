"""How work runs: processes, other machines, time, disk and memory, and what is kept between runs. Belongs here: what
would be the same in a program about something else.
"""
