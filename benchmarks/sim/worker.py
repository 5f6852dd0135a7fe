"""One measurement in a process of its own, so that its memory and start are its own: prints one line of JSON.

    python -m benchmarks.sim.worker KIND [--points N] [--count N] [--frames N] [--repeats N]

first: one frame of one design, from a fresh process
motions: `frames` frames of `count` designs; equilibria: their shapes at rest; shapes: the last of 0.1 s alone
error: RMS of 8 motions to the same with finer steps, solved further
flex: MuJoCo's flex, its CPU time and its error by number of substeps
kernel: Taichi's loops beside those in C
Seconds are by the clock (wall) and of all threads (cpu), after a call that loads the kernels; rss is the peak in bytes.
"""

import argparse
import json
import resource
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.sim.cases import TIMES, reference
from sim import Simulator

SHORT = 0.1  # s
SUBSTEPS = (4, 8)
LIMIT = {False: 32, True: 16}  # substeps that stand for MuJoCo's limit; in a quick run


@dataclass(frozen=True)
class Given:
    points: int
    count: int
    frames: int
    repeats: int


def rms(difference: NDArray[np.floating]) -> float:
    """Root of the mean square length of vectors (..., 3)."""
    return float(np.sqrt(np.mean(np.sum(np.square(difference, dtype=float), axis=-1))))


def timed(work: Callable[[], object], repeats: int) -> dict[str, Any]:
    wall, cpu = [], []
    for _ in range(repeats):
        begin = time.perf_counter(), time.process_time()
        work()
        wall.append(time.perf_counter() - begin[0])
        cpu.append(time.process_time() - begin[1])
    return {"wall": wall, "cpu": cpu, "rss": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}


def first(given: Given) -> dict[str, Any]:
    Simulator(given.points).motions(reference(1), [np.array([0.05])])
    return {}


def motions(given: Given, times: NDArray[np.float64] | None = None) -> dict[str, Any]:
    simulator, cases = Simulator(given.points), reference(given.count)
    wanted = TIMES[: given.frames] if times is None else times
    simulator.motions(cases[:1], [wanted[:1]])
    return timed(lambda: simulator.motions(cases, [wanted] * len(cases)), given.repeats)


def equilibria(given: Given) -> dict[str, Any]:
    simulator, cases = Simulator(given.points), reference(given.count)
    simulator.motions(cases[:1], [TIMES[:1]])
    return timed(lambda: simulator.equilibria(cases), given.repeats)


def shapes(given: Given) -> dict[str, Any]:
    return motions(given, np.array([SHORT]))


def error(given: Given) -> dict[str, Any]:
    cases, times = reference(given.count), np.r_[0.0, TIMES[: given.frames]]
    ours = Simulator(given.points).run(cases, [times] * len(cases))
    finer = Simulator(given.points, time_step=1 / 7680, iterations=30, tolerance=3e-8)
    limit = finer.run(cases, [times] * len(cases))
    return {
        "rms": [rms(a.middle[1:] - b.middle[1:]) for a, b in zip(ours, limit, strict=True)],
        "moved": rms(limit[0].middle[1:] - limit[0].middle[0]),
    }


def flex(given: Given) -> dict[str, Any]:
    from benchmarks.sim.flex import CHEAP, CONVERGED, motion, version

    [case], times = reference(1), TIMES[: given.frames]
    most = LIMIT[given.frames < len(TIMES)]
    limit = motion(case, times, n=given.points, substeps=most, iterations=CONVERGED)
    rows = {}
    for substeps in SUBSTEPS:
        runs = [motion(case, times, n=given.points, substeps=substeps, iterations=CHEAP) for _ in range(given.repeats)]
        rows[substeps] = {
            "cpu": [run.cpu for run in runs],
            "rms": rms(runs[0].nodes - limit.nodes),
            "unfinished": runs[0].warnings / (substeps * len(times)),
        }
    start = Simulator(given.points).run([case], [np.r_[0.0, times]])[0].middle.reshape(len(times) + 1, -1, 3)
    apart = rms((limit.nodes - limit.rest) - (start[1:] - start[0]))
    unfinished = limit.warnings / (most * len(times))
    return {
        "limit": most,
        "unfinished": unfinished,
        "rows": rows,
        "moved": rms(limit.nodes - limit.rest),
        "apart": apart,
        "version": version,
    }


def kernel(given: Given) -> dict[str, Any]:
    from benchmarks.sim import kernel

    why = kernel.missing()
    if why:
        return {"missing": why}
    apart = kernel.disagreement(given.points)
    if max(apart) > 1e-4:
        raise SystemExit(f"kernel.c disagrees with Taichi by {max(apart):.1e}")
    return {"apart": apart, "seconds": kernel.seconds(given.points, given.repeats).tolist()}


KINDS = {kind.__name__: kind for kind in (first, motions, equilibria, shapes, error, flex, kernel)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=KINDS)
    for name, value in asdict(Given(41, 1, len(TIMES), 1)).items():
        parser.add_argument(f"--{name}", type=int, default=value)
    given = vars(parser.parse_args())
    print(json.dumps(KINDS[given.pop("kind")](Given(**given))), flush=True)


if __name__ == "__main__":
    main()
