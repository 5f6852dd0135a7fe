"""Workers on a SLURM cluster, for as long as this program runs: prints the address that `--cluster` takes.

    pip install dask-jobqueue
    python examples/slurm_cluster.py --jobs 64 --cores 16 --memory "16 GB" --partition compute &
    fabdesign study sweep.toml -o result --cluster tcp://...

Ctrl-C or SIGTERM ends the jobs. On other schedulers put PBSCluster, LSFCluster or SGECluster in place of SLURMCluster;
the rest stays.
"""

import argparse
import signal
import sys


def main() -> None:
    import dask
    from dask_jobqueue import SLURMCluster

    options = arguments()
    # a worker's event loop is silent while kernels compile or run
    dask.config.set({"distributed.scheduler.worker-ttl": "1 hour"})
    cluster = SLURMCluster(
        queue=options.partition,
        cores=1,  # one batch at a time in a worker ...
        processes=1,
        job_cpu=options.cores,  # ... whose kernels take the job's cores
        memory=options.memory,
        walltime="08:00:00",
        # before the wall time a worker ends by itself: its batch goes to another and is not counted against it
        worker_extra_args=["--lifetime", "475m", "--lifetime-stagger", "4m"],
        job_script_prologue=[
            "export TI_CPU_MAX_NUM_THREADS=$SLURM_CPUS_PER_TASK OMP_NUM_THREADS=1",
            "export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False",  # else it watches itself, 3 % of a core
            "export DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL=1s DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL=2s",
        ],
    )
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    with cluster:  # leaving it cancels the jobs
        cluster.scale(jobs=options.jobs)
        print(cluster.scheduler_address, flush=True)
        signal.pause()


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Workers on a SLURM cluster, a job each.")
    parser.add_argument("--jobs", type=int, default=4)
    parser.add_argument("--cores", type=int, default=16, help="of a job")
    parser.add_argument("--memory", default="16 GB", help="of a job")
    parser.add_argument("--partition", default=None, help="by default that of the cluster")
    return parser.parse_args()


if __name__ == "__main__":
    main()
