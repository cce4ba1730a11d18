"""Processes side by side on one device: what they take over, and how many there are."""

import os

import jax
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs import device_processes
from angler_mjx.runs.simulator import stored_programs

CACHE_SECONDS = "jax_persistent_cache_min_compile_time_secs"


def describe_process(item):
    """Return the item, and what a process has taken over."""
    if item < 0:
        raise ConfigError(f"item {item}: is negative")
    return (
        item,
        getattr(jax.config, CACHE_SECONDS),
        stored_programs.are_enabled(),
        os.environ[device_processes.PREALLOCATION],
        os.getpid(),
    )


@pytest.fixture
def settings(monkeypatch):
    monkeypatch.delenv(device_processes.PREALLOCATION, raising=False)
    monkeypatch.setattr(stored_programs, "_enabled_by_command", True)
    before = getattr(jax.config, CACHE_SECONDS)
    jax.config.update(CACHE_SECONDS, 7.5)
    yield
    jax.config.update(CACHE_SECONDS, before)


def test_processes_have_the_settings_of_the_one_that_started_them(settings):
    rows = list(device_processes.map_on_devices(describe_process, [3, 1, 2], 2, __name__))
    assert [row[:4] for row in rows] == [(item, 7.5, True, "false") for item in (3, 1, 2)]
    assert os.getpid() not in {row[4] for row in rows}
    assert device_processes.PREALLOCATION not in os.environ


def test_an_error_of_a_process_is_raised_here():
    with pytest.raises(ConfigError, match="item -1: is negative"):
        list(device_processes.map_on_devices(describe_process, [-1], 2, __name__))


def test_one_process_is_this_one():
    pids = device_processes.map_on_devices(lambda _: os.getpid(), range(2), 1, __name__)
    assert list(pids) == [os.getpid()] * 2


@pytest.mark.parametrize(
    ("backend", "processors", "expected"),
    [("cpu", 64, 1), ("gpu", 1, 1), ("gpu", 2, 1), ("gpu", 12, 6), ("gpu", 64, 8)],
)
def test_a_gpu_is_shared_by_half_as_many_as_processors(monkeypatch, backend, processors, expected):
    monkeypatch.setattr(device_processes.jax, "default_backend", lambda: backend)
    monkeypatch.setattr(device_processes, "cpu_count", lambda: processors)
    assert device_processes.default_count() == expected


def test_memory_is_shared_unless_the_user_chose(monkeypatch):
    monkeypatch.delenv(device_processes.PREALLOCATION, raising=False)
    device_processes.disable_preallocation()
    assert os.environ[device_processes.PREALLOCATION] == "false"
    monkeypatch.setenv(device_processes.PREALLOCATION, "true")
    device_processes.disable_preallocation()
    assert os.environ[device_processes.PREALLOCATION] == "true"
