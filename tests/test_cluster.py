"""Check computation on a Dask cluster: identical results, lost workers and invalid schedulers."""

import os
import signal
import subprocess
import sys

import pandas as pd
import pytest
from test_cohort import compute_digests, plan_tiny_cohort
from test_extreme_cohorts import LIGHT, NAMES, make_feature_table
from test_radiomics import TEMPLATE, load_phantom, make_jobs

import pssf
from pssf import cohort
from pssf.core.processes import parallel_map
from pssf.core.processes.execution import Execution
from pssf.core.processes.parallel_map import map_in_parallel
from pssf.core.processes.worker_processes import WorkersLostError
from pssf.dataset import DatasetSettings, make_dataset, verify_dataset
from pssf.radiomics.features.feature_table import ExtractionSettings, measure_radiographs
from pssf.radiomics.radiomics_tables import radiomics_tables
from pssf.study.learn.training import train_all_splits


def start_cluster():
    """Start a local cluster of two worker processes."""
    distributed = pytest.importorskip("distributed")
    return distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)


@pytest.fixture(scope="module")
def cluster():
    """Yield a cluster of two worker processes for all tests of this module."""
    with start_cluster() as found:
        yield found


@pytest.fixture
def disposable_cluster():
    """Yield a cluster for one test, since Dask does not restart workers that die before they have reported."""
    with start_cluster() as found:
        yield found


def test_a_cohort_made_on_a_cluster_equals_that_of_one_local_worker(cluster, small_protocols, whole_cohort, tmp_path):
    cohort.make_cohort(plan_tiny_cohort(small_protocols), tmp_path / "c", scheduler=cluster.scheduler_address)
    assert compute_digests(tmp_path / "c") == compute_digests(whole_cohort)
    assert cohort.verify_cohort(tmp_path / "c").faults == ()


def test_a_data_set_made_on_a_cluster_equals_that_of_one_local_worker(cluster, tmp_path):
    settings = DatasetSettings(images=3, matrix=48, split=(2 / 3, 1 / 3, 0.0), layout="shards", shard_images=2)
    make_dataset(settings, tmp_path / "local", workers=1)
    make_dataset(settings, tmp_path / "cluster", scheduler=cluster.scheduler_address)
    assert compute_digests(tmp_path / "cluster") == compute_digests(tmp_path / "local")
    assert verify_dataset(tmp_path / "cluster") == (3, [])


def compute_with_process_id(item, offset):
    return 2 * item + offset, os.getpid()


def test_results_are_ordered_and_computed_by_cluster_processes(cluster):
    arrived = []
    found = map_in_parallel(
        compute_with_process_id,
        range(7),
        shared={"offset": 1},
        scheduler=cluster.scheduler_address,
        on_result=lambda *result: arrived.append(result),
    )
    assert [value for value, _ in found] == [1, 3, 5, 7, 9, 11, 13]
    assert sorted(arrived) == list(enumerate(found))
    assert os.getpid() not in {pid for _, pid in found}


def die_once(item, marker):
    if item == 2 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * item


def test_the_work_of_a_killed_cluster_worker_is_repeated(disposable_cluster, tmp_path):
    shared = {"marker": tmp_path / "died"}
    assert map_in_parallel(die_once, range(6), shared=shared, scheduler=disposable_cluster.scheduler_address) == [
        0,
        2,
        4,
        6,
        8,
        10,
    ]
    assert (tmp_path / "died").exists()


def die_always(item):
    if item == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


@pytest.mark.slow  # Dask starts each killed worker again before it gives up.
def test_work_that_kills_every_worker_raises_workers_lost_error(disposable_cluster):
    with pytest.raises(WorkersLostError, match="killed repeatedly"):
        map_in_parallel(die_always, range(3), shared={}, scheduler=disposable_cluster.scheduler_address)


def test_require_scheduler_waits_for_restarting_workers(disposable_cluster):
    for worker in disposable_cluster.workers.values():
        os.kill(worker.pid, signal.SIGKILL)
    parallel_map.require_scheduler(disposable_cluster.scheduler_address)


@pytest.mark.parametrize("error", [OSError("Timed out trying to connect after 30 s"), ConnectionResetError("closed")])
def test_a_scheduler_query_is_repeated_if_a_worker_dies_during_it(error):
    pytest.importorskip("distributed")
    from pssf.core.processes import cluster as module

    replies = iter([{"tcp://a:1": error}, {"tcp://a:2": ("0.1.0", [])}])

    class Client:
        def wait_for_workers(self, count, timeout):
            pass

        def run(self, function, modules, on_error):
            return next(replies)

    assert module._query_workers(Client(), ()) == [("0.1.0", [])]


def raise_input_error(item):
    raise pssf.InputError(f"item must be absent, got {item}")


def test_an_input_error_in_a_worker_is_raised_unchanged(cluster):
    with pytest.raises(pssf.InputError, match=r"^item must be absent, got 0$"):
        map_in_parallel(raise_input_error, [0], shared={}, scheduler=cluster.scheduler_address)


def test_a_scheduler_without_workers_is_rejected(monkeypatch):
    distributed = pytest.importorskip("distributed")
    from pssf.core.processes import cluster as module

    monkeypatch.setattr(module, "_WORKER_WAIT_S", 2)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as empty,
        pytest.raises(pssf.InputError, match="scheduler must have one or more workers, got none at"),
    ):
        parallel_map.require_scheduler(empty.scheduler_address)


@pytest.mark.parametrize("address", ["here", "8786", "tcp://somewhere", "http://127.0.0.1:8786"])
def test_an_invalid_scheduler_address_is_rejected(address):
    with pytest.raises(pssf.InputError, match=rf"scheduler must be .*tcp://host:8786, got '{address}'"):
        parallel_map.require_scheduler(address)


def test_the_error_for_missing_distributed_names_the_install_command(monkeypatch):
    monkeypatch.setattr(parallel_map, "find_spec", lambda name: None)
    with pytest.raises(pssf.InputError, match=r"needs the package distributed, .*pip install '.\[cluster\]'"):
        parallel_map.require_scheduler("tcp://127.0.0.1:8786")


def test_an_unreachable_scheduler_gives_a_one_line_error_and_no_files(tmp_path):
    command = [sys.executable, "-m", "pssf", "cohort", "--out", str(tmp_path / "c"), "--scheduler", "tcp://127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2
    assert done.stderr.startswith("pssf: scheduler must be ")
    assert done.stderr.rstrip().endswith("got 'tcp://127.0.0.1:9': no answer within 10 s")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_features_measured_on_a_cluster_equal_those_measured_locally(cluster):
    arguments = {
        "load_pixels": load_phantom,
        "templates": [TEMPLATE],
        "tables": radiomics_tables(),
        "settings": ExtractionSettings(region_px=96),
    }
    on_cluster, _ = measure_radiographs(
        make_jobs(3), execution=Execution(scheduler=cluster.scheduler_address), **arguments
    )
    local, _ = measure_radiographs(make_jobs(3), **arguments)
    assert on_cluster == local


def test_models_trained_on_a_cluster_equal_those_trained_locally(cluster):
    on_cluster = train_all_splits(make_feature_table(6), NAMES, LIGHT, Execution(scheduler=cluster.scheduler_address))
    local = train_all_splits(make_feature_table(6), NAMES, LIGHT, Execution())
    for one, other in zip(on_cluster, local, strict=True):
        pd.testing.assert_frame_equal(one.predictions, other.predictions, check_exact=True)


def test_a_missing_library_of_a_worker_is_named_in_the_error(cluster):
    with pytest.raises(pssf.InputError, match=r"has a worker without no_such_library: install the extra .study. "):
        parallel_map.require_scheduler(cluster.scheduler_address, ("json", "no_such_library"))
