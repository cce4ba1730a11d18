"""The table of compile times: what JAX compiled and what came out of its cache, over processes."""

import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from jax import monitoring

from angler_mjx.runs.simulator import compile_cache

from .compile_times import CompileTimes

TESTS = Path(__file__).parent
PROGRAM = """
import jax
import jax.numpy as jnp

def test_a_program():
    def {name}(x):
        return jnp.sin(x) @ x
    jax.jit({name})(jnp.ones((3, 3))).block_until_ready()
"""


def counts(text):
    """Numbers in the table by phase or name."""
    lines = re.findall(r"^ +([0-9.]+) s +(\d+) x (.*)$", text, re.M)
    return {name: int(count) for _, count, name in lines}


def test_a_program_is_compiled_once_and_loaded_then(tmp_path):
    def squared(x):
        return x @ x

    tables = []
    argument = jnp.ones((3, 3))
    with compile_cache.use_cache_folder(tmp_path):
        for _ in range(2):
            times = CompileTimes()
            monitoring.register_event_duration_secs_listener(times.listen)
            jax.clear_caches()
            jax.jit(squared).lower(argument).compile()
            tables.append(counts("\n".join(times.lines())))
            monitoring.unregister_event_duration_listener(times.listen)
    cold, cached = tables
    once = {"tracing": 1, "lowering": 1}
    assert cold == once | {"compiling": 1, "loading from the cache": 0, "jit(squared)": 1}
    assert cached == once | {"compiling": 0, "loading from the cache": 1}
    assert CompileTimes().lines() == []


def log(folder, ci):
    """Output of two processes of pytest in a folder with programs ``first`` and ``second``."""
    text = (TESTS / "conftest.py").read_text().replace("from . import", "import")
    (folder / "conftest.py").write_text(text)
    for name in ("deviations.py", "compile_times.py"):
        (folder / name).write_text((TESTS / name).read_text())
    for name in ("first", "second"):
        (folder / f"test_{name}.py").write_text(PROGRAM.format(name=name))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-n", "2", "-p", "no:cacheprovider", "--rootdir", "."],
        cwd=folder,
        env=os.environ | {"CI": ci, "JAX_ENABLE_COMPILATION_CACHE": "false"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.nightly(by="test_a_program_is_compiled_once_and_loaded_then")
def test_programs_of_two_processes_stand_in_the_log_of_ci(tmp_path):
    found = counts(log(tmp_path, ci="true"))
    assert found["jit(first)"] == found["jit(second)"] == 1
    assert found["compiling"] == found["lowering"] >= 2
    assert "compile times" not in log(tmp_path, ci="")
