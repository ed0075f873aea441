"""Check that several threads can parse new record types at the same time."""

import subprocess
import sys

# Code for a new process, because a failure (a partly initialised record type) would crash the process.
CODE = """
import sys, threading
from pssf.data.table_records import Record, parse_record
sys.setswitchinterval(1e-6)
fields = {f"f{k}": "tuple[tuple[float, ...], ...]" for k in range(40)}
inner = {name: [[1.0]] for name in fields}
outer = {f"g{k}": inner for k in range(10)}
for _ in range(200):
    A = type(Record)("A", (Record,), {"__annotations__": fields, "__module__": "__main__"}, frozen=True)
    of_a = {"__annotations__": dict.fromkeys(outer, "A"), "__module__": "__main__"}
    B = type(Record)("B", (Record,), of_a, frozen=True)
    gate = threading.Barrier(4)
    def ask(kind, table):
        gate.wait()
        parse_record(kind, table, "t")
    threads = [threading.Thread(target=ask, args=((A, inner) if k % 2 else (B, outer))) for k in range(4)]
    for thread in threads: thread.start()
    for thread in threads: thread.join()
print("done")
"""


def test_threads_parse_new_record_types_concurrently():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")
