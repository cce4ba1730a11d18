"""Simulators that are compiled once for each key, and closed when they are not held any more."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs import simulator_cache
from angler_mjx.runs.simulator_cache import SimulatorCache


class FakeSimulator:
    def __init__(self, events, name):
        self.events, self.name = events, name

    def compile_ahead(self):
        self.events.append(("compiled", self.name))

    def close(self):
        self.events.append(("closed", self.name))


@pytest.fixture
def cache():
    made = SimulatorCache()
    yield made
    made.close()


def test_a_key_is_compiled_once_and_closed_once(cache):
    events = []
    build = lambda: FakeSimulator(events, "a")  # noqa: E731
    cache.begin("a", build)
    assert cache.of("a", build) is cache.of("a", build)
    assert (events, cache.compiled) == ([("compiled", "a")], 1)
    cache.clear()
    cache.close()
    assert events == [("compiled", "a"), ("closed", "a")]


def test_the_least_recently_used_one_is_closed(cache, monkeypatch):
    monkeypatch.setattr(simulator_cache, "MAX_SIMULATORS", 2)
    events = []
    for name in ("a", "b", "a", "c"):
        cache.of(name, lambda name=name: FakeSimulator(events, name))
    assert [event for event in events if event[0] == "closed"] == [("closed", "b")]


def test_a_dropped_one_is_closed_and_compiled_again(cache):
    events = []
    build = lambda: FakeSimulator(events, "a")  # noqa: E731
    first = cache.of("a", build)
    cache.drop("a")
    cache.drop("a")
    assert events == [("compiled", "a"), ("closed", "a")]
    assert cache.of("a", build) is not first


def test_what_cannot_be_compiled_says_so_to_who_needs_it(cache):
    def build():
        raise ConfigError("no such vehicle")

    cache.begin("a", build)
    with pytest.raises(ConfigError, match="no such vehicle"):
        cache.of("a", build)
