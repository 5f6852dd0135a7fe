"""What a motion costs, beside bounds and others: writes its part of docs/lab/simulator.md.

    python -m benchmarks.sim [--only speed,flex,kernel,scaling,start] [--quick]

--only and --quick (few frames and designs) print their part instead.
"""

import argparse

from benchmarks.machine import write_part
from benchmarks.sim import parts
from benchmarks.sim.page import PAGE, PART, heading

PARTS = {part.__name__: part for part in (parts.speed, parts.flex, parts.kernel, parts.scaling, parts.start)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(PARTS), help="parts, comma separated")
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    chosen = given.only.split(",")
    unknown = [name for name in chosen if name not in PARTS]
    if unknown:
        parser.error(f"--only {', '.join(unknown)}: expected some of {', '.join(PARTS)}")
    lines = heading("make bench-sim")
    if given.quick:
        lines += ["Quick: few frames and designs, which the bounds are not for.", ""]
    for name in chosen:
        lines += PARTS[name](parts.QUICK if given.quick else parts.FULL)
    text = "\n".join(lines)
    if given.quick or set(chosen) != set(PARTS):
        print(text)
    else:
        write_part(PAGE, PART, text)


if __name__ == "__main__":
    main()
