"""The physics engines by name: each advances a tile of worlds, with the same meaning.

Every function takes and gives pytrees of one world with a leading axis [tile] on every leaf.
"""

from functools import partial
from typing import Any, Protocol

import jax

from angler_mjx.control.stack import Command
from angler_mjx.engines.lanes.engine import FusedEngine
from angler_mjx.engines.triton.engine import TritonEngine
from angler_mjx.errors import UnsupportedError
from angler_mjx.physics import mjx_engine
from angler_mjx.sim import episode
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.state import Sample, SimSpec, World, WorldState


class Engine(Protocol):
    """What a simulator asks of an engine."""

    def reset(self, spec: SimSpec, fleet: Fleet, worlds: World) -> WorldState:
        """Worlds at t = 0: robots at rest at their starts, obstacles in place."""
        ...

    def control_step(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        command: Command | None,
    ) -> tuple[WorldState, Sample]:
        """One control step.

        Args:
            spec: settings.
            fleet: compiled vehicles.
            worlds: constants of the worlds.
            state: of the worlds.
            command: to the controllers instead of the paths, [tile, R] leading.

        Returns:
            The state one control period later, and the sample of the state before.
        """
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
    ) -> tuple[WorldState, Sample]:
        """``n_sample * steps_per_sample`` control steps, all with one command.

        Samples are [tile, n_sample, ...].
        """
        ...


class MjxEngine:
    """MuJoCo MJX: multibody models, one ``vmap`` over worlds."""

    def reset(self, spec: SimSpec, fleet: Fleet, worlds: World) -> WorldState:
        """See `Engine.reset`."""
        one = partial(episode.reset, spec, _multibody(spec, fleet, worlds))
        state: WorldState = jax.vmap(one)(worlds.body, worlds)
        return state

    def control_step(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        command: Command | None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.control_step`."""
        one = partial(episode.control_step, spec)
        after: tuple[WorldState, Sample] = jax.vmap(one, (None, 0, 0, 0))(
            _multibody(spec, fleet, worlds), worlds, state, command
        )
        return after

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
    ) -> tuple[WorldState, Sample]:
        """See `Engine.segment`."""
        one = partial(episode.segment, spec, n_sample=n_sample, steps_per_sample=steps_per_sample)

        def told(world: World, state: WorldState, command: Command | None) -> Any:
            return one(_multibody(spec, fleet, worlds), world, state, command=command)

        after: tuple[WorldState, Sample] = jax.vmap(told)(worlds, state, command)
        return after


def _multibody(spec: SimSpec, fleet: Fleet, worlds: World) -> mjx_engine.MjxEngine:
    if fleet.engine is None:
        raise UnsupportedError(
            "the fleet was built without multibody models: engine mjx needs them"
        )
    if worlds.body.fields.keys() != fleet.body.fields.keys():
        raise UnsupportedError(
            "the worlds were drawn of a fleet without the multibody fields of this one: engine mjx "
            "needs them (`Simulator.adopt` gives them)"
        )
    return fleet.engine.under(spec.water.gravity_mps2)


def by_name(name: str, kernels: str) -> Engine:
    """The engine of a scenario, with the kernels it is to run on (see `default_kernels`)."""
    if name == "mjx":
        return MjxEngine()
    return TritonEngine() if kernels == "triton" else FusedEngine()


def default_kernels(name: str, platform: str) -> str:
    """What an engine runs on where nothing is said: ``xla``, or ``triton`` for fused on a GPU."""
    return "triton" if name == "fused" and platform in ("gpu", "cuda") else "xla"
