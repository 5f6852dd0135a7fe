"""Output that is whole or not there, that replaces nothing unasked, and never an input.

A command opens its output before it computes anything:

    with new_file(path, force=force, inputs=[design, pressures]) as unfinished:    # one file
    with new_files(path, force=force, inputs=[bench]) as unfinished:               # a file, and others beside it
    with new_folder(path, made_by="rig", force=force, inputs=[design]) as unfinished:

and writes to `unfinished`, which becomes `path` when the block ends well. `work_folder` is for what goes on in its
folder. `atomic_file` and `write_text` replace: they are for a piece of one's own unfinished output.

Others import from here alone. Inside: `atomic.py` (a temporary file, a rename, one lock), `ownership.py` (the mark of
what is this program's, and inputs), `unfinished.py` (the functions above).
"""

from fabdesign.output.atomic import atomic_file, cannot_write, sweep, write_text
from fabdesign.output.ownership import MARK, always_input, marked_files, others_in, read_mark, write_mark
from fabdesign.output.unfinished import Inputs, WorkFolder, given_up, new_file, new_files, new_folder, work_folder

__all__ = [
    "MARK",
    "Inputs",
    "WorkFolder",
    "always_input",
    "atomic_file",
    "cannot_write",
    "given_up",
    "marked_files",
    "new_file",
    "new_files",
    "new_folder",
    "others_in",
    "read_mark",
    "sweep",
    "work_folder",
    "write_mark",
    "write_text",
]
