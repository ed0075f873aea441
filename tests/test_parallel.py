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
    os.write(1, b"%d\\n" % os.getpid())  # in one piece, whatever the other one writes
    time.sleep(600)

if __name__ == "__main__":
    map_in_parallel(work, [1, 2], shared={}, workers=2)
"""


def double(item, offset):
    return 2 * item + offset


def test_results_come_in_order_whatever_the_number_of_workers():
    arrived = []
    found = map_in_parallel(
        double, range(7), shared={"offset": 1}, workers=2, on_result=lambda index, value: arrived.append((index, value))
    )
    assert found == map_in_parallel(double, range(7), shared={"offset": 1}) == [1, 3, 5, 7, 9, 11, 13]
    assert sorted(arrived) == list(enumerate(found))


def number_and_shared(item, **shared):
    time.sleep(0.2)  # so that one process does not do both
    return os.getpid(), shared


def test_processes_stand_between_calls_and_each_gets_what_the_next_one_shares(tmp_path, monkeypatch):
    first = map_in_parallel(number_and_shared, [1, 2], shared={"offset": 1}, workers=2)
    second = map_in_parallel(number_and_shared, [1, 2], shared={"scale": np.arange(3)}, workers=2)
    assert {number for number, _ in first} == {number for number, _ in second}
    assert len({number for number, _ in first}) == 2
    assert [shared for _, shared in first] == [{"offset": 1}] * 2
    assert all(list(shared) == ["scale"] and list(shared["scale"]) == [0, 1, 2] for _, shared in second)
    monkeypatch.chdir(tmp_path)
    elsewhere = map_in_parallel(number_and_shared, [1, 2], shared={}, workers=2)
    assert not {number for number, _ in first} & {number for number, _ in elsewhere}


class FailsToArrive:
    def __reduce__(self):
        return divmod, (1, 0)


def test_what_cannot_be_taken_up_is_an_error_and_the_next_call_works():
    with pytest.raises(ZeroDivisionError):
        map_in_parallel(double, range(4), shared={"offset": FailsToArrive()}, workers=2)
    assert map_in_parallel(double, range(4), shared={"offset": 1}, workers=2) == [1, 3, 5, 7]


def die_once(item, marker):
    if item == 3 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * item


def test_the_work_of_a_killed_worker_is_done_again_and_none_of_it_twice_over(tmp_path):
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


@pytest.mark.parametrize(("killer", "seconds"), [(0, 0.5), (1, 0.5), (4, 0.0)])
def test_work_that_kills_every_worker_is_given_up_after_all_else_was_done(killer, seconds):
    arrived = []
    shared = {"killer": killer, "seconds": seconds}
    with pytest.raises(WorkersLostError, match="worker processes were killed 3 times in a row"):
        map_in_parallel(
            die_always, range(5), shared=shared, workers=2, on_result=lambda index, _: arrived.append(index)
        )
    assert sorted(arrived) == sorted({*range(5)} - {killer})


def busy_threads(seconds):
    """Threads of this process that did more than a tenth of its work in so many seconds of linear algebra and FFT."""
    rng = np.random.default_rng(0)
    square = rng.random((600, 600))
    before, until = ticks(), time.monotonic() + seconds
    while time.monotonic() < until:
        square = square @ square / np.abs(square @ square).max()
        fft.fft2(square)
    worked = [spent - before.get(thread, 0) for thread, spent in ticks().items()]
    return sum(spent > 0.1 * sum(worked) for spent in worked)


def ticks():
    """Clock ticks that each thread of this process has computed for."""
    stats = {
        path.parent.name: path.read_text().rpartition(")")[2].split() for path in Path("/proc/self/task").glob("*/stat")
    }
    return {thread: int(fields[11]) + int(fields[12]) for thread, fields in stats.items()}


def test_a_worker_computes_in_one_thread():
    assert map_in_parallel(busy_threads, [0.5, 0.5], shared={}, workers=2) == [1, 1]


def test_cores_are_those_that_this_process_may_use(monkeypatch):
    monkeypatch.setattr(parallel_map.os, "sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    assert parallel_map.count_cores() == 3


def test_workers_end_when_their_parent_is_killed(tmp_path):
    script = tmp_path / "endless.py"
    script.write_text(ENDLESS)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        parent.send_signal(signal.SIGKILL)
    until = time.monotonic() + 30
    while any(alive(pid) for pid in workers):
        assert time.monotonic() < until, "a worker outlives its parent"
        time.sleep(0.05)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # One that nobody has waited for is dead all the same.
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
given_back = faults()
retain_freed_memory()
faults()
print(given_back, faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only GNU's C library is told")
def test_a_worker_keeps_the_memory_of_arrays_for_those_that_come():
    told = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True, check=True).stdout
    given_back, kept = map(int, told.split())
    assert given_back > 100 > 10 * kept


THREADS = """
import os
from manifold3d import Manifold
from pssf.core.processes.worker_processes import limit_manifold_to_one_thread

before = os.sched_getaffinity(0), len(os.listdir("/proc/self/task"))
if {held}:
    limit_manifold_to_one_thread()
ball = Manifold.sphere(1.0, 1000)
(ball ^ ball.translate((0.5, 0.1, 0.2))).volume()
print(before[0] == os.sched_getaffinity(0), len(os.listdir("/proc/self/task")) - before[1])
"""


@pytest.mark.skipif(
    not Path("/proc/self/task").is_dir() or parallel_map.count_cores() < 2, reason="threads are counted on Linux"
)
def test_manifold3d_is_held_to_one_thread_and_the_process_keeps_its_cores():
    def after(held):
        run = subprocess.run(
            [sys.executable, "-c", THREADS.format(held=held)], capture_output=True, text=True, check=True
        )
        return run.stdout.split()

    assert after(True) == ["True", "0"]
    assert int(after(False)[1]) > 0
