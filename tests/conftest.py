"""The order of test files, how often garbage is looked for, what tests measured and compiled."""

import gc
import os

import pytest

from angler_mjx.runs.simulator import stored_programs

from . import compile_times, cuda_on_cpu, deviations

# Tracing makes millions of objects that stay: that of a rollout takes 7.1 s instead of 8.4.
gc.set_threshold(50_000, 20, 20)

LONG = (
    "commands/test_run.py",
    "engines/test_fused_cuda.py",
    "engines/test_fused.py",
    "runs/",
    "simulator/",
    "storage/",
    "speed/",
    "benchmark/test_results.py",
    "datasets/",
    "experiments/studies/test_smoke.py",
    "tests/test_readme.py",
)
"""Files that take long come first, so that no worker is left alone with one at the end.

So does the one that makes what a file beside it asks for too, lest a worker wait for the other.
"""

TOGETHER = ("angler_mjx/learning/datasets/", "experiments/learned_planner/")
"""Folders whose files share what is made or compiled once in a process: one worker takes them."""

deviation = deviations.deviation
block_form = cuda_on_cpu.block_form
compiled_sources = cuda_on_cpu.compiled_sources
pytest_addoption = deviations.pytest_addoption
pytest_testnodedown = deviations.pytest_testnodedown
pytest_sessionfinish = deviations.pytest_sessionfinish


STORED = os.environ.get(stored_programs.SETTING, "1")
"""Executables are stored and loaded in tests too, but for those that replace code."""


def pytest_configure(config):
    os.environ[stored_programs.SETTING] = STORED
    deviations.pytest_configure(config)
    config.pluginmanager.register(compile_times.CompileTimes())


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """File by file, as ``--dist loadfile``, but for the folders that stay together."""
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class ByWhatIsShared(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return next((one for one in TOGETHER if one in nodeid), super()._split_scope(nodeid))

    return ByWhatIsShared(config, log)


def pytest_collection_modifyitems(config, items):
    nightly = {item: item.get_closest_marker("nightly") for item in items}
    for item, mark in nightly.items():
        if mark and not mark.kwargs.get("by"):
            raise pytest.UsageError(f"{item.nodeid}: nightly(by=...) says what proves it in small")
    if "nightly" not in config.getoption("markexpr"):
        long = [item for item in items if nightly[item]]
        config.hook.pytest_deselected(items=long)
        items[:] = [item for item in items if item not in long]

    def rank(item):
        found = [i for i, part in enumerate(LONG) if part in item.path.as_posix()]
        return found[0] if found else len(LONG)

    items.sort(key=rank)


@pytest.fixture(autouse=True)
def _store_nothing_of_replaced_code(request):
    """Store no executables in tests that replace code: their key is that of the code in files."""
    if "monkeypatch" in request.fixturenames:
        os.environ[stored_programs.SETTING] = "0"
    yield
    os.environ[stored_programs.SETTING] = STORED
