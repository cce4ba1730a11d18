"""What is made once for all processes that share the tests."""

import fcntl
import os
from contextlib import contextmanager


def shared_folder(tmp_path_factory, name):
    """A folder of this session of tests, the same one in all of its processes."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    folder.mkdir(exist_ok=True)
    return folder


@contextmanager
def alone(folder):
    """One process at a time."""
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
