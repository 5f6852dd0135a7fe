"""What a cluster costs: the same sweep on one process, on two workers, and on two of which one is killed.

    python -m benchmarks.cluster [DESIGNS]

Each worker, and the one process, computes with one thread, so that two workers stand beside twice one process; by the
clock only where the machine has nothing else to do, by processor seconds always. Writes docs/results/machines.md.
"""

import multiprocessing
import os
import pickle
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from benchmarks.machine import ROOT, commit, processor
from fabdesign.catalogue import build
from fabdesign.cluster import current, on_cluster
from fabdesign.forward import Case
from fabdesign.pressure_file import constant_program

PAGE = ROOT / "docs" / "results" / "machines.md"
ADDRESS = "tcp://127.0.0.1:18790"
REPEATS = 3
GRID = 21
ONE_THREAD = {"TI_CPU_MAX_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def cases(count: int) -> list[Case]:
    """*basic* under pressures by chance."""
    design = build("basic")
    drawn = np.random.default_rng(1).uniform(0, 300e3, (count, design.channels))
    return [Case(design, constant_program(row)) for row in drawn]


def compute(some: Sequence[Case]) -> tuple[Any, float, float]:
    """Points at rest, seconds by the clock and of this process."""
    from sim import Simulator

    wall, cpu = time.monotonic(), time.process_time()
    found = Simulator(GRID).equilibria(some)
    return found, time.monotonic() - wall, time.process_time() - cpu


def alone(count: int, results: Any) -> None:
    """In a process of its own: kernels first, then REPEATS times."""
    some = cases(count)
    compute(some[:8])
    results.put([compute(some) for _ in range(REPEATS)])


@contextmanager
def two_workers() -> Iterator[None]:
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(ROOT)}
    none = subprocess.DEVNULL
    quiet: dict[str, Any] = {"stdout": none, "stderr": none, "env": environment, "cwd": ROOT}
    python, port = [sys.executable, "-m"], ADDRESS.rpartition(":")[2]
    scheduler = [*python, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"]
    running = [subprocess.Popen(scheduler, **quiet)]
    worker = [*python, "distributed.cli.dask_worker", ADDRESS, "--nthreads", "1", "--no-dashboard"]
    running += [subprocess.Popen(worker, **quiet) for _ in range(2)]
    try:
        yield
    finally:
        for process in running:
            process.terminate()
        for process in running:
            process.wait()


def wait_for(count: int) -> None:
    cluster = current()
    assert cluster is not None
    cluster.client.wait_for_workers(count, timeout=300)


def worker_seconds() -> float:
    cluster = current()
    assert cluster is not None
    return sum(cluster.client.run(time.process_time).values())


def on_two(some: Sequence[Case]) -> list[tuple[Any, float, float, float]]:
    """As `compute`, REPEATS times, with the workers' seconds besides."""
    compute(some[:8] * 8)  # kernels of both
    compute(some[:8] * 8)
    found = []
    for _ in range(REPEATS):
        before = worker_seconds()
        result = compute(some)
        found.append((*result, worker_seconds() - before))
    return found


def one_killed(some: Sequence[Case]) -> tuple[Any, float]:
    """The same with a worker killed a third of the way through the sweep."""
    cluster = current()
    assert cluster is not None
    victim = next(iter(cluster.client.run(os.getpid).values()))
    wait = compute(some)[1] / 3
    killer = multiprocessing.get_context("spawn").Process(target=_kill, args=(victim, wait))
    killer.start()
    found, wall, _ = compute(some)
    killer.join()
    return found, wall


def _kill(victim: int, wait: float) -> None:
    time.sleep(wait)
    os.kill(victim, signal.SIGKILL)


def same(one: Any, other: Any) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    some = cases(count)
    os.environ |= ONE_THREAD
    results = multiprocessing.get_context("spawn").Queue()
    process = multiprocessing.get_context("spawn").Process(target=alone, args=(count, results))
    process.start()
    single = results.get()
    process.join()
    with two_workers(), on_cluster(_ready(), say=print):
        wait_for(2)
        double = on_two(some)
        killed, killed_wall = one_killed(some)
    task, answer = len(pickle.dumps(some[:16])), len(pickle.dumps(double[0][0][:16]))
    bits = [same(single[0][0], other) for other in (double[0][0], killed)]
    PAGE.write_text(page(count, single, double, bits, killed_wall, (task, answer)))
    print(PAGE.read_text())


def _ready() -> str:
    """The scheduler's address, once it listens."""
    import socket

    for _ in range(600):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", int(ADDRESS.rpartition(":")[2]))) == 0:
                return ADDRESS
        time.sleep(0.2)
    raise TimeoutError(ADDRESS)


def page(count: int, single: Any, double: Any, bits: Sequence[bool], killed_wall: float, sizes: tuple[int, int]) -> str:
    one_wall, one_cpu = (statistics.median(run[k] for run in single) for k in (1, 2))
    two_wall, client_cpu, worker_cpu = (statistics.median(run[k] for run in double) for k in (1, 2, 3))
    here = commit(PAGE)
    both = worker_cpu + client_cpu
    machine = f"{processor()}, {os.cpu_count()} cores"
    load = f"{os.getloadavg()[0]:.0f} processes wanted one"
    each = f"{16 * worker_cpu / count:.2f} s of a worker, {1e3 * 16 * client_cpu / count:.0f} ms of the caller"
    return f"""# More than one machine, measured

`python -m benchmarks.cluster {count}`: {count} shapes at rest of *basic*, {GRID} points a side, medians of
{REPEATS} runs after kernels were compiled; commit {here}.
{machine}, **shared with other work** ({load}): only processor seconds say much.
The one process and each worker compute with one thread.

| | by the clock | processor seconds | of which the caller's |
|---|---|---|---|
| one process | {one_wall:.1f} s | {one_cpu:.2f} | {one_cpu:.2f} |
| two workers | {two_wall:.1f} s | {both:.2f} | {client_cpu:.2f} |
| two, one killed a third of the way | {killed_wall:.1f} s, with a new worker that loads its kernels | | |

| | figure | bound |
|---|---|---|
| processor seconds of one process over those of two workers with their caller | **{one_cpu / both:.2f}** | 0.9 |
| by the clock, one process over twice two workers | {one_wall / (2 * two_wall):.2f} | 0.9 |
| bits of two workers are those of one process | {"yes" if bits[0] else "NO"} | yes |
| bits with one killed: nothing lost, nothing twice | {"yes" if bits[1] else "NO"} | yes |

A task of 16 designs: {sizes[0] / 1e3:.1f} kB there, {sizes[1] / 1e3:.1f} kB back, {each}.
"""


if __name__ == "__main__":
    main()
