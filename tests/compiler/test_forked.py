"""A process forked after JAX was used says so, in place of waiting for ever."""

import os
import subprocess
import sys

import pytest

SCRIPT = """
import multiprocessing, os, sys
import numpy as np
import jax.numpy as jnp
import eoi_jax as eoi
from eoi_jax.compiler import runtime

PLANT = eoi.plants.mass_spring_damper(true=True)
TIME = 0.01 * np.arange(200)

def work(queue):
    try:
        runtime.run_in_threads(lambda: None, 2)
        queue.put(len(eoi.simulate(PLANT, TIME, np.sin(TIME))))
    except ValueError as error:
        queue.put(str(error))

eoi.configure(cache=False)
if sys.argv[1] == "used":
    jnp.sin(jnp.ones(3))
if sys.argv[1] == "simulated":  # by machine code, in threads of the library's own
    eoi.simulate(PLANT, TIME, np.sin(TIME))
    runtime.run_in_threads(lambda: None, 2)
fork = multiprocessing.get_context("fork")
queue = fork.Queue()
child = fork.Process(target=work, args=(queue,))
child.start()
print(queue.get(timeout=60))
child.join(60)
assert child.exitcode == 0
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.parametrize(("before", "said"), [("used", "`process` must be started anew"),
                                              ("simulated", "200"), ("unused", "200")]
)  # fmt: skip
def test_a_fork_after_use_is_refused_and_one_before_is_not(before, said):
    run = [sys.executable, "-W", "ignore", "-c", SCRIPT, before]
    done = subprocess.run(run, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout.startswith(said), done.stderr
    assert done.returncode == 0
