"""The physics engines by name: each advances a tile of worlds, with the same meaning.

Every function takes and gives pytrees of one world with a leading axis [tile] on every leaf.
"""

from typing import Literal, Protocol

import jax

from angler_mjx.robot.control.stack import Command
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.engines.mjx import MjxEngine
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import EngineConstants, EngineState, SimSpec, World, WorldState


class Engine(Protocol):
    """What a simulator asks of an engine."""

    def reset(
        self, spec: SimSpec, fleet: Fleet, worlds: World, policy: Policy | None = None
    ) -> WorldState:
        """Worlds at t = 0: robots at rest at their starts, obstacles in place.

        Args:
            spec: settings.
            fleet: compiled vehicles.
            worlds: constants of the worlds; drawn with keys for the policy if there is one.
            policy: that is to command the robots.

        Raises:
            ConfigError: the controllers cannot be commanded by the policy.
        """
        ...

    def pack_constants(self, fleet: Fleet, worlds: World) -> EngineConstants:
        """A bank's constants as the engine reads them, made once for many control steps."""
        ...

    def pack_cells(self, worlds: World) -> jax.Array | None:
        """Cells of worlds as the engine looks them up; None where it reads the grid itself."""
        ...

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
        """One control step, or several with one command.

        Args:
            spec: settings.
            fleet: compiled vehicles.
            worlds: constants of the worlds.
            state: of the worlds.
            command: to the controllers instead of the paths, [tile, R] leading.
            policy: that commands them where ``command`` does not; the one of `reset`.
            rows: int32 [tile] which of the ``worlds`` each state is of, where they are a bank of
                any number; each state is then at a step of its own. Without them all are at one.
            constants: of `pack_constants`, of the same fleet and worlds, or nothing: only with
                ``rows``.
            steps: how many control steps.
            cells: of `pack_cells`, of the same worlds; packed in the program if left out.

        Returns:
            The state so many control periods later, and the sample of the state before one of the
            steps; what it says that robots were told is of the last.
        """
        ...

    def pack_state(self, state: WorldState) -> EngineState:
        """States as the engine keeps them from one call of `advance` to the next."""
        ...

    def unpack_state(self, packed: EngineState) -> WorldState:
        """States of `pack_state`, or of any of the following."""
        ...

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
        """States after control steps, without samples; arguments as of `control_step`."""
        ...

    def select_states(self, packed: EngineState, rows: jax.Array) -> EngineState:
        """States of worlds ``rows`` int32 [W]."""
        ...

    def replace_states(
        self, packed: EngineState, ended: jax.Array, initial: EngineState, rows: jax.Array
    ) -> EngineState:
        """States whose worlds ``ended`` bool [W] are worlds ``rows`` int32 [W] of others."""
        ...

    def replace_energy(self, packed: EngineState, energy_j: jax.Array) -> EngineState:
        """States with other energies [W, R] in their tallies."""
        ...

    def segment(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        *,
        n_sample: int,
        steps_per_sample: int,
        command: Command | None = None,
        policy: Policy | None = None,
        begins: int = 1,
        cells: jax.Array | None = None,
    ) -> tuple[WorldState, Sample]:
        """``n_sample * steps_per_sample`` control steps, all with one command, or with a policy's.

        Samples are [tile, n_sample, ...]. The number of the first step is a multiple of ``begins``:
        an engine may leave out of its program what other steps would need; ``cells`` as in
        `control_step`.
        """
        ...


def by_name(name: str, kernels: str) -> Engine:
    """The engine of a scenario, with the kernels it is to run on (see `default_kernels`)."""
    if name == "mjx":
        return MjxEngine()
    if kernels == "xla":
        return FusedEngine()
    return CudaEngine()


def default_kernels(name: str, platform: str) -> Literal["xla", "cuda"]:
    """Return the compiler of an engine's kernels where nothing is said: cuda for fused on a GPU."""
    return "cuda" if name == "fused" and platform in ("gpu", "cuda") else "xla"
