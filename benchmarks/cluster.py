"""What a cluster costs: the same sweep on one process, on two workers, and on two of which one is killed.

    python -m benchmarks.cluster [DESIGNS]

Two workers of one thread each stand beside a process of two threads (the clock, on the same two cores), and beside two
processes of one thread that compute side by side without a cluster (processor seconds: a core is slower while the
other one works). They take turns, and ratios are of neighbours in time, since a shared machine's speed drifts by more
than what is measured. Writes its part of docs/lab/machines.md.
"""

import multiprocessing
import os
import pickle
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from benchmarks.machine import ROOT, commit, processor, write_part
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.runtime.cluster import current, on_cluster

PAGE = ROOT / "docs" / "lab" / "machines.md"
ADDRESS = "tcp://127.0.0.1:18790"
REPEATS = 9
GRID = 21
WATCHED_LESS = {  # as docs/cluster.md has it: what a worker otherwise spends on watching itself is 3 % of a core
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL": "2s",
}
Run = tuple[Any, float, float]  # points at rest, seconds by the clock, processor seconds


def threads(count: int) -> dict[str, str]:
    """Of a process that is started with these variables."""
    return {"TI_CPU_MAX_NUM_THREADS": str(count), "OMP_NUM_THREADS": str(count)}


def cases(count: int) -> list[Case]:
    """*basic* under pressures by chance."""
    design = build("basic")
    drawn = np.random.default_rng(1).uniform(0, 300e3, (count, design.channels))
    return [Case(design, constant_program(row)) for row in drawn]


def compute(some: Sequence[Case]) -> Run:
    from sim import Simulator

    wall, cpu = time.monotonic(), time.process_time()
    points = Simulator(GRID).equilibria(some)
    return points, time.monotonic() - wall, time.process_time() - cpu


def _serve(some: Sequence[Case], asked: Connection) -> None:
    """In a process of its own: kernels first, then the cases as often as they are asked for."""
    compute(some[:16])
    asked.send(None)
    while asked.recv():
        asked.send(compute(some))


@contextmanager
def processes(some: Sequence[Case], count: int, *, cores: int) -> Iterator[Callable[[], Run]]:
    """Runs of the sweep in `count` processes without a cluster, its share of the cases and `cores` threads each."""
    spawn = multiprocessing.get_context("spawn")
    os.environ |= threads(cores)
    pipes = [spawn.Pipe() for _ in range(count)]
    started = [spawn.Process(target=_serve, args=(some[k::count], pipes[k][1])) for k in range(count)]
    for process in started:
        process.start()
    for here, _ in pipes:
        here.recv()

    def run() -> Run:
        for here, _ in pipes:
            here.send(True)
        parts = [here.recv() for here, _ in pipes]
        points = [parts[k % count][0][k // count] for k in range(len(some))]
        return points, max(part[1] for part in parts), sum(part[2] for part in parts)

    try:
        yield run
    finally:
        for here, _ in pipes:
            here.send(False)
        for process in started:
            process.join()


@contextmanager
def two_workers() -> Iterator[None]:
    environment = os.environ | threads(1) | WATCHED_LESS | {"PYTHONPATH": str(ROOT)}
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


def on_two(some: Sequence[Case]) -> tuple[Any, float, float, float]:
    """As `compute`, here for the caller, with the workers' seconds besides."""
    before = worker_seconds()
    result = compute(some)
    return (*result, worker_seconds() - before)


def one_killed(some: Sequence[Case]) -> tuple[Any, float]:
    """The same with a worker killed a third of the way through the sweep."""
    cluster = current()
    assert cluster is not None
    victim = next(iter(cluster.client.run(os.getpid).values()))
    wait = compute(some)[1] / 3
    killer = multiprocessing.get_context("spawn").Process(target=_kill, args=(victim, wait))
    killer.start()
    points, wall, _ = compute(some)
    killer.join()
    return points, wall


def _kill(victim: int, wait: float) -> None:
    time.sleep(wait)
    os.kill(victim, signal.SIGKILL)


def same(one: Any, other: Any) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 128
    some, load = cases(count), os.getloadavg()[0]
    wide, pair, double = [], [], []
    with (
        processes(some, 1, cores=2) as one,
        processes(some, 2, cores=1) as two,
        two_workers(),
        on_cluster(_ready(), say=print),
    ):
        wait_for(2)
        for _ in range(2):
            compute(some[:8] * 8)  # kernels of both
        for _ in range(REPEATS):
            wide.append(one())
            double.append(on_two(some))
            pair.append(two())
        killed, killed_wall = one_killed(some)
    task, answer = len(pickle.dumps(some[:16])), len(pickle.dumps(double[0][0][:16]))
    bits = [same(wide[0][0], other) for other in (pair[0][0], *(run[0] for run in double), killed)]
    figures = page(count, load, wide, pair, double, bits, killed_wall, (task, answer))
    print(figures)
    write_part(PAGE, "cluster", figures)


def _ready() -> str:
    """The scheduler's address, once it listens."""
    import socket

    for _ in range(600):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", int(ADDRESS.rpartition(":")[2]))) == 0:
                return ADDRESS
        time.sleep(0.2)
    raise TimeoutError(ADDRESS)


def page(
    count: int,
    load: float,
    wide: Sequence[Run],
    pair: Sequence[Run],
    double: Sequence[tuple[Any, float, float, float]],
    bits: Sequence[bool],
    killed_wall: float,
    sizes: tuple[int, int],
) -> str:
    (wide_wall, wide_cpu), (pair_wall, pair_cpu) = (
        tuple(statistics.median(run[k] for run in runs) for k in (1, 2)) for runs in (wide, pair)
    )
    two_wall, client_cpu, worker_cpu = (statistics.median(run[k] for run in double) for k in (1, 2, 3))
    machine = f"{processor()}, {os.cpu_count()} cores"
    by_cpu = quartiles([one[2] / (two[2] + two[3]) for one, two in zip(pair, double, strict=True)])
    by_clock = quartiles([one[1] / two[1] for one, two in zip(wide, double, strict=True)])
    each = f"{16 * worker_cpu / count:.2f} s of a worker, {1e3 * 16 * client_cpu / count:.0f} ms of the caller"
    return f"""\
`python -m benchmarks.cluster {count}`: {count} shapes at rest of *basic*, {GRID} points a side, {REPEATS} runs of
each in turn after kernels were compiled, medians; commit {commit(PAGE)}. {machine}, shared with
other work ({load:.1f} processes wanted a core before it began): ratios of neighbours in time say most.

| | by the clock | processor seconds | of which the caller's |
|---|---|---|---|
| one process, two threads | {wide_wall:.1f} s | {wide_cpu:.2f} | |
| two processes, one thread and half of the sweep each, no cluster | {pair_wall:.1f} s | {pair_cpu:.2f} | |
| two workers, one thread each | {two_wall:.1f} s | {worker_cpu + client_cpu:.2f} | {client_cpu:.2f} |
| two, one killed a third of the way | {killed_wall:.1f} s, with a new worker that loads its kernels | | |

| two workers, on the same two cores | median | quartiles | bound |
|---|---|---|---|
| by the clock, over one process: its seconds by theirs | **{by_clock[1]:.2f}** | {_range(by_clock)} | 0.9 |
| processor seconds, over two processes without a cluster | **{by_cpu[1]:.2f}** | {_range(by_cpu)} | 0.9 |
| bits of every run are those of one process | {"yes" if all(bits[:-1]) else "NO"} | | yes |
| bits with one killed: nothing lost, nothing twice | {"yes" if bits[-1] else "NO"} | | yes |

A task of 16 designs: {sizes[0] / 1e3:.1f} kB there, {sizes[1] / 1e3:.1f} kB back, {each}.
"""


def quartiles(ratios: Sequence[float]) -> list[float]:
    return statistics.quantiles(ratios, n=4, method="inclusive")


def _range(quartiles: Sequence[float]) -> str:
    return f"{quartiles[0]:.2f} to {quartiles[2]:.2f}"


if __name__ == "__main__":
    main()
