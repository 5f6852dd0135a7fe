"""Other machines: tasks go to the workers of a Dask scheduler, results come back in order (docs/cluster.md).

`on_cluster(address)` says for how long; within it whoever has much to compute asks `current()`. Without an address
nothing is imported and nothing changes. The only file here that knows `distributed`, the extra `cluster`.
"""

import logging
import os
import platform
import socket
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

from fabdesign.effects.registry import register_source, registered_sources
from fabdesign.errors import InputError, SimulationError, needs
from fabdesign.runtime.effort import cores
from fabdesign.runtime.fingerprint import sha256
from fabdesign.version import SIMULATOR, __version__

VARIABLE = "FABDESIGN_CLUSTER"
WAIT = 10.0  # s, for a scheduler to answer
MOST = 4096  # cases in a call: their results are in memory here
SILENCE = 3600.0  # s, for which a worker may be silent
TASKS = 4  # of a worker's share of a call: the fewer, the longer the last one is waited for
_GREETING = 1 << 20  # bytes that a scheduler's first words have at most
_LIBRARIES = ("taichi", "numpy", "scipy", "numba", "distributed")
_CODE = ("fabdesign", "sim", "studies/rig")  # what a task runs

Task = TypeVar("Task")
Result = TypeVar("Result")
Say = Callable[[str], None]

_current: list["Cluster"] = []
_thread = threading.local()


def current() -> "Cluster | None":
    """Return where tasks go now; None: they stay here, as within a task."""
    return None if not _current or getattr(_thread, "computes", False) else _current[-1]


def at_once(least: int) -> int:
    """Return cases that one call should bring: `least` on one machine, as many for each worker, up to MOST."""
    cluster = current()
    return least if cluster is None else max(least, min(MOST, least * cluster.workers))


@contextmanager
def on_cluster(address: str | None, *, say: Say = lambda line: None) -> Iterator[None]:
    """Return a context whose tasks go to the scheduler at `address`; None: as before it. `say` hears what is worth
    knowing.

    Raises InputError where nobody answers, or a worker has other versions than this process.
    """
    if address is None:
        yield
        return
    try:
        from distributed import Client
    except ModuleNotFoundError as error:
        raise InputError(f"{address}: {needs(error)}") from None
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # a lost worker is no news, a lost scheduler is told here
    try:
        _require_greeting(address)
        client = Client(address, timeout=WAIT, name="fabdesign")
    except InputError:
        raise
    except Exception as error:  # whatever answers there decides what is raised
        raise InputError(
            f"{address}: no scheduler answers within {WAIT:g} s ({type(error).__name__}); expected an address such as "
            "tcp://HOST:8786, or tls://HOST:8786 with certificates (docs/cluster.md)"
        ) from None
    cluster = Cluster(address, client, say)
    try:
        cluster.prepare()
        _current.append(cluster)
        yield
    finally:
        if cluster in _current:
            _current.remove(cluster)
        with suppress(Exception):  # of a scheduler that is gone
            client.close(timeout=1)


def _require_greeting(address: str) -> None:
    """Raise InputError where another program listens at a tcp address: a scheduler speaks first, with the length of
    what it says. Dask itself would wait for ever, or take any eight bytes for a length."""
    from distributed.comm.addressing import parse_address, parse_host_port

    scheme, place = parse_address(address)
    if scheme != "tcp":
        return
    with socket.create_connection(parse_host_port(place), timeout=WAIT) as connection:
        head = connection.recv(8, socket.MSG_WAITALL)
    if not 8 < int.from_bytes(head, "little") < _GREETING:
        raise InputError(f"{address}: another program answers there; expected the address that a Dask scheduler prints")


@dataclass(frozen=True)
class WorkerInfo:
    """The facts that a worker says of itself. threads: of its simulator."""

    versions: Mapping[str, str]
    processor: str
    threads: int


@dataclass(frozen=True, eq=False)
class Cluster:
    """The workers of one scheduler, as seen from here."""

    address: str
    client: Any
    say: Say = lambda line: None
    _warned: set[str] = field(default_factory=set)

    def prepare(self) -> None:
        """Raise InputError for a worker with other versions. A batch that two workers died with is not tried a third
        time, on this scheduler."""
        here = this_worker()
        try:
            self.client.run_on_scheduler(_set_limits)
            workers: dict[str, WorkerInfo] = self.client.run(this_worker)
        except (ModuleNotFoundError, AttributeError) as error:
            raise InputError(f"{self.address}: {error}; expected the fabdesign of this machine on every one") from None
        for name, worker in workers.items():
            _require_alike(worker.versions, here.versions, f"{self.address}: worker {name}")
        if others := sorted({w.processor for w in workers.values()} - {here.processor}):
            self.say(f"{self.address}: workers with other processors ({', '.join(others)}): last bits may differ")
        if not workers:
            self.say(f"{self.address}: no workers yet; waiting for them")

    @property
    def workers(self) -> int:
        """Return the number of workers now, each of which may have a task: at least 1, for where there are none work
        waits for the first."""
        try:
            count = len(self.client.nthreads())
        except _lost() as error:
            raise self._gone() from error
        if not count and "no workers" not in self._warned:
            self._warned.add("no workers")
            self.say(f"{self.address}: no workers; waiting for one")
        return max(1, count)

    @cached_property
    def threads(self) -> int:
        """Return the threads of the worker's simulator that has the most."""
        described: dict[str, WorkerInfo] = self.client.run(this_worker)
        return max((worker.threads for worker in described.values()), default=1)

    def map(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], name: Callable[[Task], str]
    ) -> Iterator[Result]:
        """Yield function(task) of every task, in their order, computed in any. function: of a module that workers have.

        A worker has one task at a time: one that waited there would be blamed for the death of another. Raises what a
        task raises; SimulationError for a task that two workers died with, with its `name`, and for a lost scheduler.
        """
        from distributed import as_completed

        call, versions, effects = uuid.uuid4().hex[:12], this_worker().versions, registered_sources()
        waiting, done, due = [*range(len(tasks))][::-1], {}, 0
        under_way: dict[Any, int] = {}
        completed = as_completed(loop=self.client.loop)
        try:
            while due < len(tasks):
                while waiting and len(under_way) < self.workers:
                    number = waiting.pop()
                    key = f"fabdesign-{call}-{number}"
                    future = self.client.submit(
                        _computed, function, tasks[number], versions, effects, key=key, pure=False
                    )
                    under_way[future] = number
                    completed.add(future)
                future = next(completed)
                number = under_way.pop(future)
                done[number] = self._result(future, partial(name, tasks[number]))
                del future  # its workers may forget it
                while due in done:
                    yield done.pop(due)
                    due += 1
        finally:
            with suppress(Exception):  # of a scheduler that is gone
                self.client.cancel(list(under_way))

    def _result(self, future: Any, name: Callable[[], str]) -> Any:
        from distributed import KilledWorker

        if future.status == "error":
            error = future.exception()
            if isinstance(error, KilledWorker):
                last = error.last_worker.address
                raise SimulationError(f"{self.address}: two workers died with {name()}; the last was {last}")
            raise error
        try:
            if future.status == "finished":
                return future.result()
        except _lost() as error:
            raise self._gone() from error
        raise self._gone()

    def _gone(self) -> SimulationError:
        return SimulationError(
            f"{self.address}: the scheduler is gone; what was finished is kept, and the same command goes on"
        )


def _lost() -> tuple[type[BaseException], ...]:
    """Return what is raised where the scheduler no longer answers."""
    from distributed.client import FutureCancelledError
    from distributed.comm.core import CommClosedError

    return FutureCancelledError, CommClosedError, OSError, TimeoutError


def _computed(function: Callable[[Task], Result], task: Task, versions: Mapping[str, str], effects: Any) -> Result:
    """Return a function's result, computed on a worker."""
    _require_alike(this_worker().versions, versions, f"worker {platform.node()}")  # it may have come later
    for source in effects:
        register_source(*source)
    _thread.computes = True  # workers may be threads of this process
    try:
        return function(task)
    finally:
        _thread.computes = False


def _require_alike(there: Mapping[str, str], here: Mapping[str, str], where: str) -> None:
    for name, version in here.items():
        if there.get(name) != version:
            raise InputError(f"{where} has {name} {there.get(name)}; expected {version}, as on this machine")


def _set_limits(dask_scheduler: Any) -> None:
    """Set the scheduler's limits: a task may outlive one worker, and one that computes or compiles may be silent."""
    dask_scheduler.allowed_failures = 1
    dask_scheduler.worker_ttl = max(dask_scheduler.worker_ttl or SILENCE, SILENCE)


@cache
def this_worker() -> WorkerInfo:
    """Return what this process says of itself."""
    top = Path(__file__).parents[2]  # what is installed may differ without a version that says so
    code = sha256(*sorted(file for package in _CODE for file in (top / package).rglob("*.py")))[:12]
    facts = {"fabdesign": __version__, "simulator": SIMULATOR, "code": code, "python": platform.python_version()}
    given = os.environ.get("TI_CPU_MAX_NUM_THREADS", "")
    threads = int(given) if given.isdecimal() and int(given) else cores()
    named: list[str] = []
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = named[0] if named else platform.processor() or platform.machine()
    return WorkerInfo(facts | {name: library_version(name) for name in _LIBRARIES}, processor, threads)


def library_version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "none"
