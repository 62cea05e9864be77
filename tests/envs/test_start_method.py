"""What ``gymnasium.make`` does to the program that calls it, seen from a process of its own."""

import subprocess
import sys

PROGRAM = """
import multiprocessing, sys
import gymnasium
multiprocessing.set_start_method("forkserver")
env = gymnasium.make("dirl.envs:dirl/Navigation-v0", scene="bathroom_02", goal=26)
env.reset(seed=0)
assert "torchrl" in sys.modules
print(multiprocessing.get_start_method(allow_none=True))
"""


def test_gymnasium_make_leaves_the_start_method_of_processes_alone(tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=3600,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "forkserver\n"), done.stderr
