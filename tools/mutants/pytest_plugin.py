"""A plugin of pytest for the runs of mutants: bounds the process, and keeps the order of files.

The bounds are set in here rather than between fork and exec, where a program with threads must not
run Python.
"""

import os
import resource
from pathlib import Path

import pytest

CORES = "MUTANTS_CORES"
"""Environment variable: processors for the tests, with commas."""
MEMORY_BYTES = 64 << 30
"""Of addresses: a fault may ask for arrays without end, and must fail at that rather than take the
machine with it. JAX alone maps some 10 GiB."""


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests(early_config: pytest.Config) -> None:
    """Before anything of the project is imported."""
    os.sched_setaffinity(0, {int(core) for core in os.environ[CORES].split(",")})
    _, hard_limit = resource.getrlimit(resource.RLIMIT_AS)
    soft_limit = (
        MEMORY_BYTES if hard_limit == resource.RLIM_INFINITY else min(MEMORY_BYTES, hard_limit)
    )
    resource.setrlimit(resource.RLIMIT_AS, (soft_limit, hard_limit))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort by the place of each item's file on the command line, whatever conftest says."""
    order = {Path(name).resolve(): i for i, name in enumerate(config.args)}
    items.sort(key=lambda item: order.get(item.path.resolve(), len(order)))
