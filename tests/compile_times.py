"""Seconds that JAX takes in all tests to trace, lower and compile, at the end of CI's log.

Counted in the processes of pytest, not in those that tests start. Seconds are those of the clock on
the wall, summed over processes and threads.
"""

import os
import sys
import threading
from collections import Counter

import pytest

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowering",
    "/jax/core/compile/backend_compile_duration": "compiling",
}
RETRIEVED = "/jax/compilation_cache/cache_retrieval_time_sec"
LOADED = "loading from the cache"
PHASES = (*EVENTS.values(), LOADED)
SLOWEST = 10
KEY = "compile_times"


class CompileTimes:
    """A plugin of pytest, one in each of its processes."""

    def __init__(self):
        self.seconds, self.count = Counter(), Counter()
        self.by_program, self.count_by_program = Counter(), Counter()
        self._thread, self._lock = threading.local(), threading.Lock()

    def listen(self, event, seconds, *, fun_name="", **_):
        """Count one event of `jax.monitoring`; a retrieval precedes its end in the same thread."""
        if event == RETRIEVED:
            self._thread.is_loaded = True
        phase = EVENTS.get(event)
        if phase is None:
            return
        if phase == "compiling" and getattr(self._thread, "is_loaded", False):
            phase, self._thread.is_loaded = LOADED, False
        with self._lock:
            self.seconds[phase] += seconds
            self.count[phase] += 1
            if phase == "compiling":
                self.by_program[fun_name] += seconds
                self.count_by_program[fun_name] += 1

    def lines(self):
        """Return the table, line by line; empty where nothing was traced."""
        if not self.count:
            return []
        return [
            *(f"{self.seconds[phase]:9.1f} s {self.count[phase]:7d} x {phase}" for phase in PHASES),
            "longest to compile, by name:",
            *(
                f"{seconds:9.1f} s {self.count_by_program[name]:7d} x {name}"
                for name, seconds in self.by_program.most_common(SLOWEST)
            ),
        ]

    def pytest_collection_finish(self):
        """Listen from here on; a process that has not imported JAX by now compiles nothing."""
        if "jax" in sys.modules:
            from jax import monitoring

            monitoring.register_event_duration_secs_listener(self.listen)

    def pytest_sessionfinish(self, session):
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput[KEY] = [dict(counts) for counts in self._counters()]

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node):
        held = getattr(node, "workeroutput", {}).get(KEY, [])
        for counter, counts in zip(self._counters(), held, strict=False):
            counter.update(counts)

    def pytest_terminal_summary(self, terminalreporter):
        if os.environ.get("CI") and (lines := self.lines()):
            terminalreporter.section("compile times")
            for line in lines:
                terminalreporter.write_line(line)

    def _counters(self):
        return (self.seconds, self.count, self.by_program, self.count_by_program)
