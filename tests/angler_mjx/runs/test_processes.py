"""Meetings of processes whose signs arrive in any order."""

import json

import pytest

from angler_mjx.errors import RunError
from angler_mjx.runs.processes import KEY_ROOT, ManyProcesses

MEETING = f"{KEY_ROOT}/one/"


class Store:
    """A store of two processes, of which this one's watch sees the other fail at its first look.

    The other's value is there after ``late`` looks.
    """

    def __init__(self, late):
        self.values, self.late = {}, late

    def key_value_set(self, key, value, allow_overwrite=False):
        self.values[key] = value

    def key_value_dir_get(self, key):
        found = [entry for entry in self.values.items() if entry[0].startswith(key)]
        if key == MEETING:
            self.processes._failure = "process 1 failed: its disk is full"
            self.late -= 1
            if self.late < 0:
                found.append((f"{MEETING}1", json.dumps("there")))
        return found


def join(store):
    store.processes = ManyProcesses(store, gone_s=60.0)
    store.processes.count = 2
    return store.processes


def test_who_came_and_failed_then_was_at_the_meeting():
    store = Store(late=1)
    processes = join(store)
    try:
        assert processes.meet("one", "here") == ["here", "there"]
        with pytest.raises(RunError, match="process 1 failed: its disk is full"):
            processes.check()
    finally:
        processes._end_watch()


def test_who_failed_before_ends_the_wait():
    store = Store(late=10**9)
    processes = join(store)
    try:
        with pytest.raises(RunError, match="its disk is full; process 0 ends too"):
            processes.meet("one", "here")
    finally:
        processes._end_watch()
