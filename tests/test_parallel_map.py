"""Parallel map over worker processes: order, shared data, killed workers, threads and memory."""

import os
import platform
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy import fft

from pssf.core.processes import parallel_map
from pssf.core.processes.parallel_map import map_in_parallel
from pssf.core.processes.worker_processes import WorkersLostError

ENDLESS = """
import os, time
from pssf.core.processes.parallel_map import map_in_parallel

def work(item):
    os.write(1, b"%d\\n" % os.getpid())  # one write, so that the lines of two workers do not mix
    time.sleep(600)

if __name__ == "__main__":
    map_in_parallel(work, [1, 2], shared={}, workers=2)
"""

UNPICKLABLE = """
import time
from pssf.core.processes.parallel_map import map_in_parallel

class Item:
    def __init__(self, delay_s):
        self.delay_s = delay_s

    def __reduce__(self):
        time.sleep(self.delay_s)
        raise AttributeError("no pickle")

if __name__ == "__main__":
    try:
        map_in_parallel(print, [Item(0), Item(1)], shared={}, workers=2)
    except AttributeError as error:
        print(error)
"""


def double(item, offset):
    return 2 * item + offset


def test_results_are_in_order_for_any_number_of_workers():
    arrived = []
    found = map_in_parallel(
        double, range(7), shared={"offset": 1}, workers=2, on_result=lambda index, value: arrived.append((index, value))
    )
    assert found == map_in_parallel(double, range(7), shared={"offset": 1}) == [1, 3, 5, 7, 9, 11, 13]
    assert sorted(arrived) == list(enumerate(found))


def test_items_that_cannot_be_pickled_raise_an_error_and_do_not_block(tmp_path):
    """Check items of which the second fails after the pool was told to shut down because of the first."""
    script = tmp_path / "unpicklable.py"
    script.write_text(UNPICKLABLE)
    finished = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=100, check=True)
    assert finished.stdout.splitlines() == ["no pickle"]


def return_pid_and_shared(item, **shared):
    # The delay ensures that the two items are processed by different workers.
    time.sleep(0.2)
    return os.getpid(), shared


def test_worker_processes_persist_and_receive_the_data_of_each_call(tmp_path, monkeypatch):
    first = map_in_parallel(return_pid_and_shared, [1, 2], shared={"offset": 1}, workers=2)
    second = map_in_parallel(return_pid_and_shared, [1, 2], shared={"scale": np.arange(3)}, workers=2)
    assert {number for number, _ in first} == {number for number, _ in second}
    assert len({number for number, _ in first}) == 2
    assert [shared for _, shared in first] == [{"offset": 1}] * 2
    assert all(list(shared) == ["scale"] and list(shared["scale"]) == [0, 1, 2] for _, shared in second)
    monkeypatch.chdir(tmp_path)
    elsewhere = map_in_parallel(return_pid_and_shared, [1, 2], shared={}, workers=2)
    assert not {number for number, _ in first} & {number for number, _ in elsewhere}


class FailsToArrive:
    def __reduce__(self):
        return divmod, (1, 0)


def test_an_unpicklable_argument_raises_an_error_and_the_next_call_works():
    with pytest.raises(ZeroDivisionError):
        map_in_parallel(double, range(4), shared={"offset": FailsToArrive()}, workers=2)
    assert map_in_parallel(double, range(4), shared={"offset": 1}, workers=2) == [1, 3, 5, 7]


def die_once(item, marker):
    if item == 3 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * item


def test_the_work_of_a_killed_worker_is_repeated_once(tmp_path):
    arrived = []
    shared = {"marker": tmp_path / "died"}
    found = map_in_parallel(
        die_once, range(6), shared=shared, workers=2, on_result=lambda *result: arrived.append(result)
    )
    assert (tmp_path / "died").exists()
    assert found == [0, 2, 4, 6, 8, 10]
    assert sorted(arrived) == list(enumerate(found))


def die_always(item, killer, seconds):
    if item == killer:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(seconds)
    return item


@pytest.mark.parametrize(("killer", "seconds"), [(0, 0.5), (4, 0.0)])
def test_an_item_that_kills_every_worker_fails_after_the_other_items(killer, seconds):
    arrived = []
    shared = {"killer": killer, "seconds": seconds}
    with pytest.raises(WorkersLostError, match="worker processes were killed 3 times in a row"):
        map_in_parallel(
            die_always, range(5), shared=shared, workers=2, on_result=lambda index, _: arrived.append(index)
        )
    assert sorted(arrived) == sorted({*range(5)} - {killer})


def count_busy_threads(seconds):
    """Count the threads that perform more than a tenth of linear algebra and FFT computations of the process."""
    rng = np.random.default_rng(0)
    square = rng.random((600, 600))
    before, until = read_clock_ticks(), time.monotonic() + seconds
    while time.monotonic() < until:
        square = square @ square / np.abs(square @ square).max()
        fft.fft2(square)
    worked = [spent - before.get(thread, 0) for thread, spent in read_clock_ticks().items()]
    return sum(spent > 0.1 * sum(worked) for spent in worked)


def read_clock_ticks():
    """Read the CPU time of each thread of the process, in clock ticks."""
    stats = {
        path.parent.name: path.read_text().rpartition(")")[2].split() for path in Path("/proc/self/task").glob("*/stat")
    }
    return {thread: int(fields[11]) + int(fields[12]) for thread, fields in stats.items()}


def test_a_worker_uses_one_thread():
    assert map_in_parallel(count_busy_threads, [0.5, 0.5], shared={}, workers=2) == [1, 1]


def test_the_number_of_cores_is_the_number_this_process_may_use(monkeypatch):
    monkeypatch.setattr(parallel_map.os, "sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    assert parallel_map.count_cores() == 3


def test_workers_end_when_their_parent_is_killed(tmp_path):
    script = tmp_path / "endless.py"
    script.write_text(ENDLESS)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        parent.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 30
    while any(is_alive(pid) for pid in workers):
        assert time.monotonic() < deadline, "a worker outlives its parent"
        time.sleep(0.05)


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # A zombie process has ended, but no parent has collected the exit code.
    return "Z" not in subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout


FAULTS = """
import resource
import numpy as np
from pssf.core.processes.worker_processes import retain_freed_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(2_000_000, np.uint8)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

faults()
first_faults = faults()
retain_freed_memory()
faults()
print(first_faults, faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs GNU's C library")
def test_a_worker_reuses_freed_memory_for_later_arrays():
    output = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True, check=True).stdout
    first_faults, kept = map(int, output.split())
    assert first_faults > 100 > 10 * kept


THREADS = """
import os
from manifold3d import Manifold
from pssf.core.processes.worker_processes import limit_manifold_to_one_thread

before = os.sched_getaffinity(0), len(os.listdir("/proc/self/task"))
if {limited}:
    limit_manifold_to_one_thread()
ball = Manifold.sphere(1.0, 1000)
(ball ^ ball.translate((0.5, 0.1, 0.2))).volume()
print(before[0] == os.sched_getaffinity(0), len(os.listdir("/proc/self/task")) - before[1])
"""


@pytest.mark.skipif(
    not Path("/proc/self/task").is_dir() or parallel_map.count_cores() < 2, reason="threads are counted on Linux"
)
def test_manifold3d_uses_one_thread_without_changing_available_cores():
    def run_threads(limited):
        run = subprocess.run(
            [sys.executable, "-c", THREADS.format(limited=limited)], capture_output=True, text=True, check=True
        )
        return run.stdout.split()

    assert run_threads(True) == ["True", "0"]
    assert int(run_threads(False)[1]) > 0
