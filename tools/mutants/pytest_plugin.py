"""Plugin of pytest for the runs of mutants: limits the process, and keeps the order of files.

The limits are set in the process rather than between fork and exec, where a program with threads
must not run Python.
"""

import os
import resource
from pathlib import Path

import pytest

CORES = "MUTANTS_CORES"
"""Environment variable: processors for the tests, separated by commas."""
MEMORY_BYTES = 64 << 30
"""Limit of the address space: a fault may allocate arrays without end, and must fail before it
exhausts the machine. JAX alone maps some 10 GiB."""


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests(early_config: pytest.Config) -> None:
    """Set the limits before anything of the project is imported."""
    os.sched_setaffinity(0, {int(core) for core in os.environ[CORES].split(",")})
    _, hard_limit = resource.getrlimit(resource.RLIMIT_AS)
    soft_limit = (
        MEMORY_BYTES if hard_limit == resource.RLIM_INFINITY else min(MEMORY_BYTES, hard_limit)
    )
    resource.setrlimit(resource.RLIMIT_AS, (soft_limit, hard_limit))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort items by the position of their files on the command line, regardless of conftest."""
    order = {Path(name).resolve(): i for i, name in enumerate(config.args)}
    items.sort(key=lambda item: order.get(item.path.resolve(), len(order)))
