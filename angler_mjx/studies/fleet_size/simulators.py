"""Compiled simulators, as few as the sizes and conditions of a study need.

A team of another size is another program, and compiling one takes longer than flying a batch. Two
conditions share a simulator where their scenarios differ in nothing but the current, its form is
the same and nobody plans by it: the worlds are drawn once, and each gets the current that it would
have been drawn with. So still water among moving ones is ``randomise.current = [0.0, 0.0]``; an
empty list of currents is another form, and another program.
"""

import gc
import json
import os
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np

from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World
from angler_mjx.simulator.prepare import current_of
from angler_mjx.simulator.simulator import Simulator
from angler_mjx.studies.fleet_size.asking import Condition, Study

MOST = 24
"""Simulators that are held at a time: the programs of more would use up the memory maps that a
process may have."""


class Simulators:
    """The simulators of a study, compiled when they are needed or a little before."""

    def __init__(self, study: Study, *, tile: int, devices: int | None) -> None:
        """Nothing is compiled yet.

        Args:
            study: whose.
            tile: worlds of one device in one call.
            devices: to fly on; all if None.
        """
        self._study, self._tile, self._devices = study, tile, devices
        self._threads = ThreadPoolExecutor(
            max(1, (os.cpu_count() or 1) // 4), thread_name_prefix="simulator"
        )
        self._held: OrderedDict[str, Future[Simulator]] = OrderedDict()
        self._drawing: dict[str, Any] = {}
        self.compiled = 0
        """How many were compiled."""

    def begin(self, condition: Condition, size: int) -> None:
        """Begin to compile what will be needed, if it is not there."""
        self._future(condition, size)

    def of(self, condition: Condition, size: int) -> Simulator:
        """A compiled simulator.

        Raises:
            ConfigError, RunError: as of `Simulator` and its ``compile``.
        """
        made = self._future(condition, size).result()
        while len(self._held) > MOST:
            _, old = self._held.popitem(last=False)
            if not old.cancel():
                old.result().close()
            del old
            gc.collect()
        return made

    def change(
        self, condition: Condition, size: int, simulator: Simulator, firsts: Sequence[int], w: World
    ) -> World:
        """Worlds of a simulator as the condition has them.

        Args:
            condition: that is flown.
            size: of the team.
            simulator: of `of`.
            firsts: first world of each device's tile.
            w: worlds as the simulator drew them.
        """
        scenario = self._study.scenario(condition, size)
        if not _parts_with_current(scenario):
            return w
        key = _text(scenario, ("world", "time", "randomise"))
        if key not in self._drawing:
            one = jax.vmap(partial(current_of, scenario), in_axes=(None, 0))
            self._drawing[key] = jax.jit(one)
        index = np.concatenate(
            [np.arange(first, first + self._tile, dtype=np.uint32) for first in firsts]
        )
        drawn = self._drawing[key](np.uint32(scenario.seed), index)
        place = w.environment.start_m.sharding
        current = jax.device_put(drawn, place)
        return replace(w, environment=replace(w.environment, current=current))

    def close(self) -> None:
        """End what plans on the host, and wait for what is being compiled."""
        self._threads.shutdown(cancel_futures=True)
        for future in self._held.values():
            if not future.cancelled() and future.exception() is None:
                future.result().close()

    def _future(self, condition: Condition, size: int) -> Future[Simulator]:
        scenario = self._study.scenario(condition, size)
        key = _key(scenario)
        if key not in self._held:
            self._held[key] = self._threads.submit(self._make, scenario)
        self._held.move_to_end(key)
        return self._held[key]

    def _make(self, scenario: Scenario) -> Simulator:
        made = Simulator(_canonical(scenario), tile=self._tile, devices=self._devices)
        made.compile()
        self.compiled += 1
        return made


def _parts_with_current(scenario: Scenario) -> bool:
    """Whether the current can be put into worlds that were drawn without regard to it."""
    knows = scenario.planner.knows
    return (
        scenario.planner.name != "current"
        and knows.current == "nothing"
        and knows.obstacles == "nothing"
        and bool(scenario.world.currents)
        and scenario.randomise.sensor_noise == (1.0, 1.0)
    )


def _canonical(scenario: Scenario) -> Scenario:
    """The scenario whose programs serve all that differ from it in the current alone."""
    if not _parts_with_current(scenario):
        return scenario
    randomise = scenario.randomise.model_copy(update={"current": (1.0, 1.0)})
    return scenario.model_copy(update={"randomise": randomise})


def _key(scenario: Scenario) -> str:
    """Of the programs of a scenario: the same text is the same programs."""
    table = scenario.model_dump(mode="json")
    if _parts_with_current(scenario):
        shapes = jax.eval_shape(
            partial(current_of, scenario),
            jax.ShapeDtypeStruct((), np.uint32),
            jax.ShapeDtypeStruct((), np.uint32),
        )
        table["world"]["currents"] = str(jax.tree.structure(shapes)) + str(jax.tree.leaves(shapes))
        table["randomise"]["current"] = None
    for name in ("name", "description"):
        table.pop(name)
    return json.dumps(table, sort_keys=True)


def _text(scenario: Scenario, tables: Sequence[str]) -> str:
    return scenario.model_dump_json(include=set(tables))
