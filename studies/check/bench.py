"""What `calibrate` will say of a bench, and keys that nothing reads."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from fabdesign.bench import Bench
from fabdesign.bench_file import read_bench
from fabdesign.table import nearest, parse_toml
from studies.benches.needs import SIZES, require_columns, require_sizes
from studies.check.findings import Findings, failures

_TEXTS = ("format", "name", "specimen", "output", "description", "source")
_CONSTANTS = {"muscle": SIZES, "strip": ("width", "direction")}  # that a law's file takes; others are labels


def bench_findings(path: Path) -> Findings:
    """Of a bench and all its records. Raises InputError for what reading refuses."""
    bench = read_bench(path)
    found = failures([partial(require_columns, bench, bench.records), partial(require_sizes, bench)])
    return found + Findings(warnings=tuple(f"{path}: {line}" for line in _unread(path, bench)))


def _unread(path: Path, bench: Bench) -> Iterator[str]:
    for key, value in parse_toml(path).items():
        if isinstance(value, str) and key not in _TEXTS:
            yield f"{key} is a text that nothing reads{nearest(key, _TEXTS)}"
    wanted = [name for name in _CONSTANTS.get(bench.specimen, ()) if name not in bench.constants]
    for name in bench.constants:
        if meant := nearest(name, wanted):
            yield f"{name} is a constant that nothing reads{meant}"
