"""The fused engine as kernels in CUDA C: a control period in registers.

Four kernels make a control step: one for each phase of robots (controllers, physics steps,
detection with the tally), and the obstacles. A block works on neighbouring worlds of one robot
of the fleet; its state stays in registers over all physics steps of the control period, and it
writes the record itself. Other shapes are read from memory, so fleets of any size fit. Robots of
one vehicle share a kernel.
Phases of worlds, where there are any (instruments and filters, policies), are plain JAX between
the kernels.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.stack import Command
from angler_mjx.sim import sample_clearances
from angler_mjx.sim import world_phases as running
from angler_mjx.sim.approach import last_approaches_s
from angler_mjx.sim.engines.cuda import launch
from angler_mjx.sim.engines.cuda.kernels import KernelLaunch, Kernels
from angler_mjx.sim.engines.cuda.packed_state import PackedState, fill
from angler_mjx.sim.engines.cuda.segment import MAX_STEPS_AHEAD, Segment, SegmentArrays
from angler_mjx.sim.engines.cuda.tile import Tile
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.engines.lanes.layout import pack_cells
from angler_mjx.sim.fleet import Fleet, add_parameters
from angler_mjx.sim.policy import Policy
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import EngineConstants, EngineState, SimSpec, World, WorldState
from angler_mjx.sim.step_repetition import repeat_steps
from angler_mjx.sim.world_phases import WorldMemory, WorldPhaseOutput

UNROLLED_STEPS = 10
"""Control steps in the body of the loop; a multiple of `MAX_STEPS_AHEAD`."""

BLOCK = 32
"""Lanes of a block: one warp, so that a block skips what none of its lanes needs."""


type Drivers = tuple[Command | None, Policy | None, jax.Array | None]
"""Command, policy and packed cells of a segment."""


class CudaEngine:
    """Closed-form rigid bodies in kernels."""

    def __init__(
        self,
        *,
        block: int = BLOCK,
        interpret: bool = False,
    ) -> None:
        """Choose how kernels are launched.

        Args:
            block: robots of a block.
            interpret: run the kernels as ordinary JAX, on any device.
        """
        self._shape = launch.LaunchShape(block=block, interpret=interpret)

    def reset(
        self, spec: SimSpec, fleet: Fleet, worlds: World, policy: Policy | None = None
    ) -> WorldState:
        """See `Engine.reset`."""
        return FusedEngine().reset(spec, fleet, worlds, policy)

    def pack_constants(self, fleet: Fleet, worlds: World) -> EngineConstants:
        """See `Engine.pack_constants`: constants in flat arrays."""
        return Tile(fleet, worlds).constants

    def pack_cells(self, worlds: World) -> jax.Array:
        """See `Engine.pack_cells`."""
        return pack_cells(worlds)

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
        if steps > 1 and running.has_world_phases(spec, running.active_policy(policy, command)):
            again = partial(
                self.control_step,
                spec,
                fleet,
                worlds,
                command=command,
                policy=policy,
                rows=rows,
                constants=constants,
                cells=cells,
            )
            return repeat_steps(again, state, steps)
        after, sample = self._run_segment(
            spec,
            fleet,
            worlds,
            self.pack_state(state),
            1,
            steps,
            command,
            policy,
            cells,
            rows,
            constants,
        )
        return after.unpack(), jax.tree.map(lambda leaf: leaf[:, 0], sample)

    def pack_state(self, state: WorldState) -> PackedState:
        """See `Engine.pack_state`: planes of lanes."""
        packing = None if self._shape.interpret else self._shape
        return PackedState.of(state, self._shape.block, packing)

    def unpack_state(self, packed: EngineState) -> WorldState:
        """See `Engine.unpack_state`."""
        return _check_packed(packed).unpack()

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

        def advance_once(packed: PackedState, steps: int) -> PackedState:
            return self._run_segment(
                spec, fleet, worlds, packed, 1, steps, command, None, None, rows, constants
            )[0]

        now = _check_packed(packed)
        if not running.has_world_phases(spec, None):
            return advance_once(now, steps)
        return jax.lax.fori_loop(0, steps, lambda _, state: advance_once(state, 1), now)

    def select_states(self, packed: EngineState, rows: jax.Array) -> EngineState:
        """See `Engine.select_states`."""
        states = _check_packed(packed)
        extra = -len(rows) % self._shape.block
        return replace(states.select(fill(rows, extra)), worlds=len(rows))

    def replace_states(
        self, packed: EngineState, ended: jax.Array, initial: EngineState, rows: jax.Array
    ) -> EngineState:
        """See `Engine.replace_states`."""
        return _check_packed(packed).replace_worlds(ended, _check_packed(initial), rows)

    def replace_energy(self, packed: EngineState, energy_j: jax.Array) -> EngineState:
        """See `Engine.replace_energy`."""
        return _check_packed(packed).replace_energy(energy_j)

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
        """See `Engine.segment`."""

        def plain(
            fleet: Fleet, worlds: World, state: WorldState, drivers: Drivers
        ) -> tuple[WorldState, Sample]:
            command, policy, cells = drivers
            return FusedEngine().segment(
                spec,
                fleet,
                worlds,
                state,
                n_sample=n_sample,
                steps_per_sample=steps_per_sample,
                command=command,
                policy=policy,
                cells=cells,
            )

        def fast(
            fleet: Fleet, worlds: World, state: WorldState, drivers: Drivers
        ) -> tuple[WorldState, Sample]:
            command, policy, cells = drivers
            after, samples = self._run_segment(
                spec,
                fleet,
                worlds,
                self.pack_state(state),
                n_sample,
                steps_per_sample,
                command,
                policy,
                cells,
                begins=begins,
            )
            return after.unpack(), samples

        both = launch.with_gradient_of(plain, fast)
        return both(fleet, worlds, state, (command, policy, cells))

    def _run_segment(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: PackedState,
        n_sample: int,
        steps_per_sample: int,
        command: Command | None,
        policy: Policy | None,
        cells: jax.Array | None,
        rows: jax.Array | None = None,
        constants: EngineConstants = (),
        begins: int = 1,
    ) -> tuple[PackedState, Sample]:
        """Run whole blocks: the last world is repeated until they are full, and cut off again."""
        extra = state.filled - state.worlds
        row_worlds = worlds if rows is None else jax.tree.map(lambda leaf: leaf[rows], worlds)
        command, rows, flying = fill((command, rows, row_worlds), extra)
        equipped = add_parameters(fleet, flying)
        policy = running.active_policy(policy, command)
        watched = running.observes_obstacles(policy)
        run_phases, output = (
            partial(running.run_tile_phases, spec, policy, equipped, fleet=fleet),
            None,
        )
        if running.has_world_phases(spec, policy):
            whole = jax.eval_shape(PackedState.unpack_filled, state)
            bodies = whole.obstacles if watched else None
            number = state.step[0] if rows is None else state.step
            ended = whole.tally.outcome if spec.by_task else None
            _, output = jax.eval_shape(
                run_phases, state.memory, number, whole.vehicles, bodies, ended
            )
        begin_s = None
        if policy is None:
            begin_s = jax.vmap(partial(last_approaches_s, spec))(flying, command)
        if rows is None:
            tile = Tile(fleet, flying, None, constants, fill(cells, extra))
        else:
            tile = Tile(fleet, worlds, rows, constants, cells)
        steps = n_sample * steps_per_sample
        period = running.phase_period(spec, policy) if rows is None and steps > 1 else 1

        def laid_out(ahead: int) -> tuple[Segment, tuple[KernelLaunch, KernelLaunch]]:
            ahead, also = min(ahead, steps), spec.also
            part = Segment(
                tile,
                state,
                n_sample,
                steps_per_sample,
                command,
                output,
                ahead=ahead,
                also=also,
                last_approach_s=begin_s,
                packing=None if self._shape.interpret else self._shape,
            )
            return part, Kernels(self._shape, spec, part).build_launches()

        usual = laid_out(_steps_ahead(period, watched))

        def run_periods(
            period: int, prepared: tuple[Segment, tuple[KernelLaunch, KernelLaunch]]
        ) -> tuple[PackedState, Sample]:
            """With phases of worlds that act once a period, where the segment begins with one."""
            part, launches = prepared
            if output is None:
                alone = _run_looped if self._shape.interpret else _run_unrolled
                return part.collect_result(alone(launches, part))
            run_period_phases = partial(run_phases, every=period)
            phase_launch = partial(
                _run_world_phases, run_period_phases, part, watched, spec.by_task, hold=period
            )
            if period == 1:
                return part.collect_result(_run_looped(launches, part, phase_launch))
            return part.collect_result(_run_periodic(launches, part, phase_launch, period))

        if begins % period == 0:
            end = run_periods(period, usual)
        else:
            # Between two of their times; who sees obstacles must not see them ahead.
            seen = watched and tile.some_obstacle
            otherwise = partial(run_periods, 1, laid_out(1) if seen else usual)
            now = state.step[0] % period == 0
            end = jax.lax.cond(now, partial(run_periods, period, usual), otherwise)
        after = end[0]
        samples = jax.tree.map(lambda leaf: leaf[: state.worlds], end[1])
        return after, sample_clearances.add_all_clearances(
            spec, add_parameters(fleet, row_worlds), samples
        )


def _check_packed(state: EngineState) -> PackedState:
    """Return a state of this engine."""
    if not isinstance(state, PackedState):
        raise TypeError(f"{type(state).__name__} is no state of `CudaEngine.pack_state`")
    return state


def _steps_ahead(period: int, watched: bool) -> int:
    """Control steps that obstacles are moved ahead of the robots.

    They may be as far ahead as the phases of worlds, which act once a period, are away: those that
    see them see them now.
    """
    if period == 1:
        return 1 if watched else MAX_STEPS_AHEAD
    return max(steps for steps in range(1, MAX_STEPS_AHEAD + 1) if period % steps == 0)


def _run_world_phases(
    run_phases: Callable[..., tuple[WorldMemory, WorldPhaseOutput]],
    part: Segment,
    watched: bool,
    by_task: bool,
    base: jax.Array,
    k: jax.Array,
    x: SegmentArrays,
    hold: int = 1,
) -> SegmentArrays:
    """The phases of worlds in control step ``base + k``, and their record: no kernel.

    Where a policy has obstacles ``watched``, they are not ahead of the robots yet; ``by_task``, a
    task asks how robots ended. What they give and record holds for ``hold`` steps.
    """
    tile, count = part.tile, base[0] + k[0]
    number = (part.first if tile.some_rows else part.first[0]) + count
    lead = (tile.worlds, tile.robots)
    vehicles = part.layouts["vehicle"].unpack(x.slots["vehicle"], lead)
    ended = part.layouts["tally"].unpack(x.slots["tally"], lead).outcome if by_task else None
    bodies = part.bodies.unpack(x.bodies, (tile.worlds, tile.obstacles)) if watched else None
    memory, output = run_phases(x.memory, number, vehicles, bodies, ended)

    def record(kept: jax.Array, new: jax.Array) -> jax.Array:
        for later in range(1 + math.ceil((hold - 1) / part.every)):
            sample_index = count // part.every + later
            is_sample = (sample_index * part.every >= count) & (
                sample_index * part.every < count + hold
            )
            kept = kept.at[sample_index].set(jnp.where(is_sample, new, kept[sample_index]))
        return kept

    packed = {
        name: part.layouts[name].pack(tree, tile.dtype) for name, tree in output.to_slots().items()
    }
    return replace(
        x,
        memory=memory,
        slots={**x.slots, **packed},
        phase_records=jax.tree.map(record, x.phase_records, output.record),
    )


def _run_unrolled(launches: tuple[KernelLaunch, KernelLaunch], part: Segment) -> SegmentArrays:
    """The arrays after all steps of a segment."""
    obstacles, robots = launches

    def steps(base: jax.Array, count: int, x: SegmentArrays) -> SegmentArrays:
        for k in range(count):
            at = jnp.array([k], jnp.int32)
            if k % MAX_STEPS_AHEAD == 0:
                x = obstacles(base, at, x)
            x = robots(base, at, x)
        return x

    return _run_chunks(steps, UNROLLED_STEPS, part.steps, jnp.zeros(1, jnp.int32), part.start)


def _run_periodic(
    launches: tuple[KernelLaunch, KernelLaunch],
    part: Segment,
    phase_launch: KernelLaunch,
    period: int,
) -> SegmentArrays:
    """As `_run_unrolled`, with ``phase_launch`` before the robots act, once a period."""
    now = jnp.zeros(1, jnp.int32)
    obstacles, robots = launches

    def run_chunk(base: jax.Array, count: int, x: SegmentArrays) -> SegmentArrays:
        x = obstacles(base, now, x)
        for k in range(count):
            x = robots(base, jnp.array([k], jnp.int32), x)
        return x

    def steps(base: jax.Array, count: int, x: SegmentArrays) -> SegmentArrays:
        return _run_chunks(run_chunk, part.ahead, count, base, phase_launch(base, now, x))

    return _run_chunks(steps, period, part.steps, now, part.start)


def _run_looped(
    launches: tuple[KernelLaunch, KernelLaunch],
    part: Segment,
    phase_launch: KernelLaunch | None = None,
) -> SegmentArrays:
    """As `_run_unrolled`, with ``phase_launch`` before the robots act; one long body."""
    obstacles, robots = launches
    now = jnp.zeros(1, jnp.int32)

    def steps(base: jax.Array, count: int, x: SegmentArrays) -> SegmentArrays:
        def step_once(x: SegmentArrays, k: jax.Array) -> tuple[SegmentArrays, None]:
            updated = x if phase_launch is None else phase_launch(base, k[None], x)
            if part.ahead == 1:  # `tell` sees where they are before they move
                updated = obstacles(base, now, updated)
            return robots(base, k[None], updated), None

        if part.ahead > 1:
            x = obstacles(base, now, x)
        return jax.lax.scan(step_once, x, jnp.arange(count, dtype=jnp.int32))[0]

    return _run_chunks(steps, part.ahead, part.steps, now, part.start)


def _run_chunks(
    steps: Callable[[jax.Array, int, SegmentArrays], SegmentArrays],
    size: int,
    total: int,
    base: jax.Array,
    x: SegmentArrays,
) -> SegmentArrays:
    """A number of control steps in chunks of ``size``.

    Args:
        steps: of a base int32 [1], a number of steps from there, and the arrays.
        size: of a chunk.
        total: control steps.
        base: int32 [1] the first of them.
        x: the arrays before.
    """

    def run_chunk(
        carry: tuple[jax.Array, SegmentArrays], _: None
    ) -> tuple[tuple[jax.Array, SegmentArrays], None]:
        base, x = carry
        x = steps(base, size, x)
        return (base + size, x), None

    chunks, rest = divmod(total, size)
    if chunks:
        (base, x), _ = jax.lax.scan(run_chunk, (base, x), length=chunks)
    return steps(base, rest, x) if rest else x
