import os
import signal
import subprocess
import sys
import time

from pssf.parallel import ordered_map

ENDLESS = """
import os, time
from pssf.parallel import ordered_map

def work(item):
    print(os.getpid(), flush=True)
    time.sleep(600)

if __name__ == "__main__":
    ordered_map(work, [1, 2], shared={}, workers=2)
"""


def double(item, offset):
    return 2 * item + offset


def test_results_come_in_order_whatever_the_number_of_workers():
    arrived = []
    found = ordered_map(
        double, range(7), shared={"offset": 1}, workers=2, arrived=lambda index, value: arrived.append((index, value))
    )
    assert found == ordered_map(double, range(7), shared={"offset": 1}) == [1, 3, 5, 7, 9, 11, 13]
    assert sorted(arrived) == list(enumerate(found))


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
