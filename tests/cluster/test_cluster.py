"""Batches on the workers of a Dask scheduler: same bits, whoever dies; what cannot work is said in a line."""

import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.errors import InputError, SimulationError
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns import column
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.lead import Lead, Way
from fabdesign.runtime import cluster as machines
from fabdesign.runtime.cluster import Cluster, current, on_cluster
from fabdesign.study_files.sensitivity_file import SensitivityStudy, Varied
from fabdesign.study_files.study_file import read_head
from sim import Simulator
from sim.on_cluster import OnCluster, batches
from studies.rig import GroundTruth
from studies.rig.run import shapes_of
from studies.rig.scene import DEFAULT
from studies.rig.specimen import TrialTask
from studies.sensitivity.run import run_sensitivity
from tests.analytic_cloth import AnalyticCloth, WithJacobian
from tests.command_line import Run, one_line
from tests.conftest import ROOT
from tests.dying import Dying, refuse

pytest.importorskip("distributed", reason="the extra cluster is not installed")
LANES = 8


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a scheduler with two workers, a process each."""
    from distributed import LocalCluster

    sys.path.insert(0, str(ROOT))  # workers load tests.dying
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as local:
        yield local.scheduler_address


def cases(count: int = 40) -> list[Case]:
    drawn = np.random.default_rng(1).uniform(0, 300e3, (count, 2))
    designs = [build("cross", muscles=2), build("vertical", muscles=2)]
    return [Case(designs[k % 2], constant_program(row)) for k, row in enumerate(drawn)]


def sweep(**changes: object) -> SensitivityStudy:
    study = SensitivityStudy(
        name="sweep",
        design=build("vertical", muscles=2),
        varied=(
            Varied("pressure.0", "pressure", (0,), 0.0, 300.0, "kPa"),
            Varied("pressure.1", "pressure", (1,), 0.0, 300.0, "kPa"),
        ),
        joint=False,
        outputs=("tip",),
        pressures=np.zeros(2),
        methods=("sobol",),
        samples=16,
    )
    return replace(study, **changes)  # type: ignore[arg-type]


def test_a_sweep_is_the_same_whoever_dies(address: str, tmp_path: Path) -> None:
    here = run_sensitivity(sweep(), tmp_path / "here", forward=AnalyticCloth())
    with on_cluster(address):
        there = run_sensitivity(sweep(), tmp_path / "there", forward=OnCluster(Dying(tmp_path / "died"), _now()))
    assert (tmp_path / "died").exists()
    assert there.complete
    files = [(tmp_path / place / "samples.csv").read_bytes() for place in ("here", "there")]
    assert files[0] == files[1] and here.computed["sobol"].values.shape[0] == 16


def test_a_batch_that_two_workers_die_with_is_named(address: str) -> None:
    deadly = Case(build("side", muscles=2, name="deadly"), constant_program([1e5, 0.0]))
    with on_cluster(address), pytest.raises(SimulationError) as error:
        OnCluster(Dying(design="deadly"), _now()).equilibria([deadly])
    assert "two workers died with a batch of 1 motions of deadly" in str(error.value)
    with on_cluster(address):  # which go on
        assert len(OnCluster(AnalyticCloth(), _now()).equilibria(cases(3))) == 3


def test_motions_come_back_in_their_order(address: str) -> None:
    times = [np.linspace(0, 0.1, 2 + k % 3) for k in range(40)]
    with on_cluster(address):
        there = OnCluster(AnalyticCloth(), _now()).motions(cases(), times)
    for one, other in zip(there, AnalyticCloth().motions(cases(), times), strict=True):
        assert np.array_equal(one, other)


def test_columns_travel_with_their_cases(address: str) -> None:
    columns = [column.pressure(1), column.corner(0, 1, (1.0, 0.0))]
    with on_cluster(address):
        there = OnCluster(WithJacobian(), _now()).ask("faces_jacobian", cases(9), columns=columns)
    for one, other in zip(there, WithJacobian().faces_jacobian(cases(9), columns), strict=True):
        assert np.array_equal(one.changes, other.changes)


def test_what_a_task_raises_is_raised_here(address: str) -> None:
    with on_cluster(address), pytest.raises(InputError, match=r"^expected as many$"):
        [*_now().map(refuse, [1], str)]


def test_rig_trials_are_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    class Elsewhere:
        def map(self, function: object, tasks: list[TrialTask], name: Callable[[TrialTask], str]) -> Iterator[str]:
            yield from (f"{function.__name__} of {name(task)}" for task in tasks)  # type: ignore[attr-defined]

    monkeypatch.setattr("studies.rig.run.current", Elsewhere)
    task = TrialTask(build("cross"), constant_program([0.0, 0.0]), np.zeros(1), 3, GroundTruth(), DEFAULT)
    assert [*shapes_of([task], 1)] == ["control_points of trial 3 of cross"]


def test_a_worker_of_another_version_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    machines.this_worker.cache_clear()
    monkeypatch.setattr(machines, "library_version", lambda _: "1.0")
    problem = r"worker \S+ has taichi 1\.7\.4; expected 1\.0, as on this machine$"
    with pytest.raises(InputError, match=problem), on_cluster(address):
        pass
    machines.this_worker.cache_clear()


def test_a_scheduler_that_is_gone_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster

    monkeypatch.setattr(machines, "WAIT", 0.5)
    local = LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None)
    gone = "the scheduler is gone; what was finished is kept"
    with local, on_cluster(local.scheduler_address), pytest.raises(SimulationError, match=gone):
        results = _now().map(str, [1, 2, 3], str)
        next(results)
        local.close()
        next(results)


def test_nobody_there_is_bad_input(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machines, "WAIT", 0.3)
    monkeypatch.chdir(folder)
    command = ("predict", "set", "--model", "model.toml", "-o", "out")
    one_line(run(*command, "--cluster", "tcp://127.0.0.1:9"), "tcp://127.0.0.1:9: no scheduler answers within 0.3 s")
    monkeypatch.setenv("FABDESIGN_CLUSTER", "tcp://127.0.0.1:10")
    one_line(run(*command), "tcp://127.0.0.1:10: no scheduler answers")
    (folder / "s.toml").write_text('kind = "layouts"\ncluster = "tcp://127.0.0.1:11"\n')
    assert read_head(folder / "s.toml").cluster == "tcp://127.0.0.1:11"
    one_line(run("study", "s.toml", "-o", "out"), "tcp://127.0.0.1:10: no scheduler answers")
    monkeypatch.delenv("FABDESIGN_CLUSTER")
    one_line(run("study", "s.toml", "-o", "out"), "tcp://127.0.0.1:11: no scheduler answers")


def test_the_simulator_asks_the_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    class Elsewhere:
        workers, threads = 2, 1

        def map(self, function: object, tasks: list[tuple], name: object) -> Iterator[list[str]]:
            yield from ([f"{method} of {model.points_per_side}"] * len(batch) for model, method, batch, _ in tasks)

    monkeypatch.setattr("sim.simulator.current", Elsewhere)
    simulator, some, times = Simulator(21), cases(12), [np.array([0.1])] * 12
    assert simulator.equilibria(some) == ["equilibria of 21"] * 12
    assert [simulator.motions(some, times)[0], simulator.run(some, times)[0], simulator.rest(some)[0]] == [
        "motions of 21", "run of 21", "rest of 21",
    ]  # fmt: skip
    assert simulator.faces_jacobian(some, []) == ["faces_jacobian of 21"] * 12
    lead = Lead(np.array([0.0, 1.0]), np.zeros((2, 21, 21, 3)))
    assert simulator.led(some, [Way(time, lead) for time in times]) == ["led of 21"] * 12


def test_batches_fill_lanes() -> None:
    parts = batches(cases(100), None, workers=2, threads=1)
    assert sorted(i for part in parts for i in part) == [*range(100)]
    assert {len(part) % LANES for part in parts[:-1]} == {0} and len(parts) == 7  # of 16: four for each worker, or near
    assert [len(part) for part in batches(cases(1000), None, workers=2, threads=16)] == [64] * 15 + [40]
    times = [np.array([0.1 * (k % 2)]) for k in range(16)]
    assert [{k % 2 for k in part} for part in batches(cases(16), times, workers=1, threads=1)] == [{0}, {1}]


def _now() -> Cluster:
    cluster = current()
    assert cluster is not None
    return cluster


@pytest.mark.parametrize("reply", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"SSH-2.0-OpenSSH_9.2\r\n", bytes(64), b"\x01"])
def test_another_program_at_the_address_is_a_line(reply: bytes, run: Run, folder: Path) -> None:
    """Its first eight bytes are no length: nobody asks for exbibytes, or waits for ever."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with suppress(OSError):
                connection, _ = server.accept()
                with connection:
                    connection.sendall(reply)

        threading.Thread(target=answer, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        arguments = ("predict", folder / "set", "--model", folder / "model.toml", "-o", folder / "out")
        one_line(run(*arguments, "--cluster", address), f"{address}: another program answers there; expected")


def test_a_cluster_with_certificates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask's own configuration holds; who has no certificate of this authority is not let in."""
    import dask
    from distributed import LocalCluster, Security

    if shutil.which("openssl") is None:
        pytest.skip("no openssl makes a certificate here")
    key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "cert.pem")
    make = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "rsa:2048",
        "-nodes",
        "-days",
        "1",
        "-subj",
        "/CN=localhost",
        "-keyout",
    ]
    subprocess.run([*make, key, "-out", certificate], check=True, capture_output=True)
    pairs = {f"tls_{who}_{what}": path for who in ("scheduler", "worker", "client") for what, path in
             (("key", key), ("cert", certificate))}  # fmt: skip
    security = Security(tls_ca_file=certificate, require_encryption=True, **pairs)
    tls = {"ca-file": certificate, "client.key": key, "client.cert": certificate}
    configured = {f"distributed.comm.tls.{name}": value for name, value in tls.items()}
    with LocalCluster(
        n_workers=1, processes=False, dashboard_address=None, protocol="tls://", security=security
    ) as local:
        address = local.scheduler_address
        assert address.startswith("tls://")
        with dask.config.set(configured), on_cluster(address):
            assert current() is not None
            assert [*_now().map(abs, [-1, 2], str)] == [1, 2]
        monkeypatch.setattr(machines, "WAIT", 3.0)
        for wrong in (address, address.replace("tls:", "tcp:")):
            with pytest.raises(InputError, match=f"^{wrong}: .*expected"), on_cluster(wrong):
                pass
