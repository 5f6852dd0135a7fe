"""Workers on a SLURM cluster, for as long as this program runs: prints the address that `--cluster` takes.

    pip install dask-jobqueue
    python examples/slurm_cluster.py 64 &        # 64 jobs of one worker with 16 cores each
    fabdesign study sweep.toml -o result --cluster tcp://...

On other schedulers put PBSCluster, LSFCluster or SGECluster in place of SLURMCluster; the rest stays.
"""

import signal
import sys


def main(jobs: int) -> None:
    import dask
    from dask_jobqueue import SLURMCluster

    # a worker's event loop is silent while kernels compile or run
    dask.config.set({"distributed.scheduler.worker-ttl": "1 hour"})
    cluster = SLURMCluster(
        queue="compute",
        cores=1,  # one batch at a time in a worker ...
        processes=1,
        job_cpu=16,  # ... whose kernels take the job's cores
        memory="16 GB",
        walltime="08:00:00",
        # before the wall time a worker ends by itself: its batch goes to another and is not counted against it
        worker_extra_args=["--lifetime", "7h55m", "--lifetime-stagger", "4m"],
        job_script_prologue=[
            "export TI_CPU_MAX_NUM_THREADS=$SLURM_CPUS_PER_TASK OMP_NUM_THREADS=1",
            "export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False",  # else it watches itself, 3 % of a core
            "export DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL=1s DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL=2s",
        ],
    )
    cluster.scale(jobs=jobs)
    print(cluster.scheduler_address, flush=True)
    signal.pause()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
