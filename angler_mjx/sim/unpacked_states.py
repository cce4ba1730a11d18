"""States of worlds for engines that keep them as they are, between the steps too."""

from abc import ABC, abstractmethod
from dataclasses import replace

import jax

from angler_mjx.robot.control.stack import Command
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import (
    EngineConstants,
    EngineState,
    SimSpec,
    World,
    WorldState,
    replace_worlds,
)


class UnpackedStates(ABC):
    """Engine whose `Engine.pack_state` changes nothing."""

    @abstractmethod
    def control_step(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        command: Command | None,
        policy: Policy | None = None,
        rows: jax.Array | None = None,
        constants: EngineConstants = (),
        steps: int = 1,
        cells: jax.Array | None = None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.control_step`."""

    def pack_state(self, state: WorldState) -> EngineState:
        """See `Engine.pack_state`."""
        return state

    def unpack_state(self, packed: EngineState) -> WorldState:
        """See `Engine.unpack_state`."""
        return _check_state(packed)

    def advance(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        packed: EngineState,
        command: Command | None,
        rows: jax.Array,
        constants: EngineConstants,
        steps: int,
    ) -> EngineState:
        """See `Engine.advance`."""
        state = _check_state(packed)
        return self.control_step(
            spec, fleet, worlds, state, command, rows=rows, constants=constants, steps=steps
        )[0]

    def select_states(self, packed: EngineState, rows: jax.Array) -> EngineState:
        """See `Engine.select_states`."""
        return jax.tree.map(lambda leaf: leaf[rows], _check_state(packed))

    def replace_states(
        self, packed: EngineState, ended: jax.Array, initial: EngineState, rows: jax.Array
    ) -> EngineState:
        """See `Engine.replace_states`."""
        return replace_worlds(_check_state(packed), ended, _check_state(initial), rows)

    def replace_energy(self, packed: EngineState, energy_j: jax.Array) -> EngineState:
        """See `Engine.replace_energy`."""
        state = _check_state(packed)
        return replace(state, tally=replace(state.tally, energy_j=energy_j))


def _check_state(state: EngineState) -> WorldState:
    if not isinstance(state, WorldState):
        raise TypeError(f"{type(state).__name__} is no WorldState, which this engine keeps")
    return state
