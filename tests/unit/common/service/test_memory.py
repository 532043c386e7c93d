from __future__ import annotations

import subprocess
import sys

COUNT = """
import resource, sys
import numpy as np
from common.service.memory import keep_freed_memory
if sys.argv[1] == "kept":
    assert keep_freed_memory()
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
def work():
    first = np.ones((720, 1280, 3), np.uint8)
    return first, first + 1, first.astype(np.uint16)
for _ in range(3):
    work()
before = faults()
for _ in range(20):
    work()
print(faults() - before)
"""


def faults(how: str) -> int:
    done = subprocess.run([sys.executable, "-c", COUNT, how], capture_output=True, text=True, check=True, timeout=100)
    return int(done.stdout)


def test_pictures_that_come_and_go_take_the_same_pages() -> None:
    assert faults("kept") < faults("as it is") / 10
