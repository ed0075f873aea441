import os
import signal
import subprocess
import sys

import pandas as pd
import pytest
from test_cohort import digests, tiny
from test_evidence import LIGHT, NAMES, table
from test_radiomics import TEMPLATE, jobs, load_phantom

import pssf
from pssf import cohort
from pssf.core.processes import parallel_map
from pssf.core.processes.execution import Execution
from pssf.core.processes.parallel_map import map_in_parallel
from pssf.core.processes.worker_processes import WorkersLostError
from pssf.radiomics.features.feature_table import ExtractionSettings, measure_radiographs
from pssf.radiomics.radiomics_tables import radiomics_tables
from pssf.study.learn.training import train_all_splits


def two_workers():
    distributed = pytest.importorskip("distributed")
    return distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)


@pytest.fixture(scope="module")
def cluster():
    """A scheduler with two worker processes."""
    with two_workers() as found:
        yield found


@pytest.fixture
def doomed():
    """The same for one test: Dask's nanny gives up a worker that dies before the nanny heard that it runs."""
    with two_workers() as found:
        yield found


def test_a_cluster_gives_the_bytes_of_one_worker_here(cluster, small_protocols, whole_cohort, tmp_path):
    cohort.make_cohort(tiny(small_protocols), tmp_path / "c", scheduler=cluster.scheduler_address)
    assert digests(tmp_path / "c") == digests(whole_cohort)
    assert cohort.verify_cohort(tmp_path / "c").faults == ()


def where(item, offset):
    return 2 * item + offset, os.getpid()


def test_results_come_in_order_from_the_cluster_and_not_from_here(cluster):
    arrived = []
    found = map_in_parallel(
        where,
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


def test_the_work_of_a_killed_worker_of_the_cluster_is_done_again(doomed, tmp_path):
    shared = {"marker": tmp_path / "died"}
    assert map_in_parallel(die_once, range(6), shared=shared, scheduler=doomed.scheduler_address) == [0, 2, 4, 6, 8, 10]
    assert (tmp_path / "died").exists()


def die_always(item):
    if item == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def test_work_that_kills_every_worker_of_the_cluster_is_given_up(doomed):
    with pytest.raises(WorkersLostError, match="killed repeatedly"):
        map_in_parallel(die_always, range(3), shared={}, scheduler=doomed.scheduler_address)


def test_workers_that_have_just_died_are_waited_for(doomed):
    for worker in doomed.workers.values():
        os.kill(worker.pid, signal.SIGKILL)
    parallel_map.require_scheduler(doomed.scheduler_address)


@pytest.mark.parametrize("error", [OSError("Timed out trying to connect after 30 s"), ConnectionResetError("closed")])
def test_a_worker_that_dies_as_it_is_asked_is_asked_again(error):
    pytest.importorskip("distributed")
    from pssf.core.processes import cluster as module

    replies = iter([{"tcp://a:1": error}, {"tcp://a:2": ("0.1.0", [])}])

    class Client:
        def wait_for_workers(self, count, timeout):
            pass

        def run(self, function, modules, on_error):
            return next(replies)

    assert module._query_workers(Client(), ()) == [("0.1.0", [])]


def refuse(item):
    raise pssf.InputError(f"item = {item}; allowed: none")


def test_a_refusal_by_a_worker_arrives_as_it_is(cluster):
    with pytest.raises(pssf.InputError, match=r"^item = 0; allowed: none$"):
        map_in_parallel(refuse, [0], shared={}, scheduler=cluster.scheduler_address)


def test_a_scheduler_without_workers_is_refused(monkeypatch):
    distributed = pytest.importorskip("distributed")
    from pssf.core.processes import cluster as module

    monkeypatch.setattr(module, "_WORKER_WAIT_S", 2)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as empty,
        pytest.raises(pssf.InputError, match="scheduler must have one or more workers, got none at"),
    ):
        parallel_map.require_scheduler(empty.scheduler_address)


@pytest.mark.parametrize("address", ["here", "8786", "tcp://somewhere", "http://127.0.0.1:8786"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(pssf.InputError, match=rf"scheduler must be .*tcp://host:8786, got '{address}'"):
        parallel_map.require_scheduler(address)


def test_a_missing_library_is_refused_with_the_way_to_get_it(monkeypatch):
    monkeypatch.setattr(parallel_map, "find_spec", lambda name: None)
    with pytest.raises(pssf.InputError, match=r"without the package distributed, got .*pip install '.\[cluster\]'"):
        parallel_map.require_scheduler("tcp://127.0.0.1:8786")


def test_a_scheduler_that_does_not_answer_is_told_in_one_line_and_nothing_is_left(tmp_path):
    command = [sys.executable, "-m", "pssf", "cohort", "--out", str(tmp_path / "c"), "--scheduler", "tcp://127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2
    assert done.stderr.startswith("pssf: scheduler must be ")
    assert done.stderr.rstrip().endswith("got 'tcp://127.0.0.1:9': no answer within 10 s")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_regions_are_measured_on_the_cluster_as_they_are_here(cluster):
    how = {
        "load_pixels": load_phantom,
        "templates": [TEMPLATE],
        "tables": radiomics_tables(),
        "settings": ExtractionSettings(region_px=96),
    }
    there, _ = measure_radiographs(jobs(3), execution=Execution(scheduler=cluster.scheduler_address), **how)
    here, _ = measure_radiographs(jobs(3), **how)
    assert there == here


def test_splits_are_taken_on_the_cluster_as_they_are_here(cluster):
    there = train_all_splits(table(6), NAMES, LIGHT, Execution(scheduler=cluster.scheduler_address))
    here = train_all_splits(table(6), NAMES, LIGHT, Execution())
    for one, other in zip(there, here, strict=True):
        pd.testing.assert_frame_equal(one.predictions, other.predictions, check_exact=True)


def test_a_worker_without_a_library_is_refused_by_name(cluster):
    with pytest.raises(pssf.InputError, match=r"must have the extra .study. .*, got .*without no_such_library"):
        parallel_map.require_scheduler(cluster.scheduler_address, ("json", "no_such_library"))
