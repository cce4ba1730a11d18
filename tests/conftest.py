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
    "angler_mjx/runs/",
    "sim/engines/",
    "speed/",
    "studies/benchmark/",
    "datasets/",
    "angler_mjx/planning/",
    "angler_mjx/learning/",
    "experiments/studies/test_smoke.py",
    "tests/test_readme.py",
)
"""Folders that take long come first, so that no worker is left alone with one at the end."""

TOGETHER = ("angler_mjx/runs/", "angler_mjx/sim/engines/", "angler_mjx/studies/benchmark/")
"""Folders that one worker takes with all that is in them: they share scenarios and flights."""

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
    """Folder by folder in place of ``--dist loadfile``.

    The files of a folder use the same fixtures and programs: of two workers that take them, each
    compiles and flies everything.
    """
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class ByFolder(LoadFileScheduling):
        def _split_scope(self, nodeid):
            folder = nodeid.partition("::")[0].rpartition("/")[0] + "/"
            return next((name for name in TOGETHER if name in folder), folder)

    return ByFolder(config, log)


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
