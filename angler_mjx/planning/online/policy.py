"""Policy that follows plans in flight: in their passing order, and with replanning."""

from dataclasses import dataclass, field, replace

import jax

from angler_mjx.errors import ConfigError
from angler_mjx.planning.online import guidance, order, replanning
from angler_mjx.planning.online.guidance import HeardProgress, PlanProgress, PlanStatus
from angler_mjx.planning.online.order import PassingOrder
from angler_mjx.planning.online.replanning import FleetPlans, Replanning
from angler_mjx.robot.control.commands import Estimate, PoseTarget
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws.follow import FollowCarry, FollowGains
from angler_mjx.robot.control.plans import Plan
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy, PolicyInput


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ReplanningMemory:
    """Memory of one world."""

    clocks: FollowCarry
    """[R]"""
    order: PassingOrder | None
    status: PlanStatus | None
    """Robots for which others no longer wait, if order is kept."""
    plans: FleetPlans | None
    """Present plans with replanning; None: the world's own."""
    progress: PlanProgress | None = None
    """Progress of each robot for the others, if order is kept by acoustics."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Online(Policy):
    """Guides a team along its plans by poses, as the guidance of the cascade does."""

    gains: FollowGains = field(default_factory=FollowGains)
    dt_s: float = field(default=0.05, metadata={"static": True})
    """Control period."""
    keeps_order: bool = field(default=False, metadata={"static": True})
    """Whether robots wait for those that pass first."""
    replanning: Replanning | None = field(default=None, metadata={"static": True})
    information: Information | None = field(default=None, metadata={"static": True})
    observation_period: int = field(default=1, metadata={"static": True})
    ahead_s: float = field(default=0.0, metadata={"static": True})

    def reset(self, inputs: PolicyInput, key: jax.Array) -> ReplanningMemory:
        """See `Policy.reset`.

        Raises:
            ConfigError: plans are to be made anew, and the world's are no way-points.
        """
        plans = None
        if self.replanning is not None:
            if not isinstance(inputs.path, Trajectory):
                raise ConfigError(
                    f"planner.replan_hz: the plans at the start are {type(inputs.path).__name__}s; "
                    "replanning goes on from a Trajectory"
                )
            plans = replanning.initial_plans(self.replanning, inputs)
        path = inputs.path if plans is None else plans.now
        clocks = guidance.initial_clocks(inputs.belief.q)
        return ReplanningMemory(
            clocks=clocks,
            order=self._build_order(path, inputs),
            status=guidance.initial_status(clocks.clock_s) if self.keeps_order else None,
            plans=plans,
            progress=self._initial_progress(inputs, clocks),
        )

    def _initial_progress(self, inputs: PolicyInput, clocks: FollowCarry) -> PlanProgress | None:
        if inputs.others is None:
            return None
        if self.replanning is not None:
            raise ConfigError(
                "planner.replan_hz: a team is planned for from where all robots are, and acoustics "
                'do not tell that to anybody; leave it out, or take acoustics.model = "perfect"'
            )
        if not self.keeps_order:
            return None
        return guidance.build_progress(clocks.clock_s, None)

    def payload(self, carry: ReplanningMemory) -> PlanProgress | None:
        """See `Policy.payload`."""
        return carry.progress

    def act(
        self, carry: ReplanningMemory, inputs: PolicyInput, key: jax.Array, step: jax.Array
    ) -> tuple[ReplanningMemory, PoseTarget]:
        """See `Policy.act`."""
        if self.replanning is not None:
            carry = self._replan_if_due(self.replanning, carry, inputs, key, step)
        path = inputs.path if carry.plans is None else carry.plans.now
        estimate = Estimate(p=inputs.belief.p, q=inputs.belief.q, nu=inputs.belief.nu)
        cruise, heard = inputs.params.cruise_speed_mps, None
        if carry.progress is not None and inputs.others is not None:
            heard = HeardProgress(others=inputs.others, time_s=inputs.time_s)
        clocks, target, status = guidance.step(
            self.gains,
            carry.clocks,
            estimate,
            path,
            carry.order,
            cruise,
            self.dt_s,
            carry.status,
            heard,
        )
        progress = None
        if heard is not None:
            progress_s = guidance.progress_s(carry.clocks, estimate, path, cruise)
            progress = guidance.build_progress(progress_s, carry.status)
        return replace(carry, clocks=clocks, status=status, progress=progress), target

    def executed_plans(self, carry: ReplanningMemory, path: Plan) -> tuple[Plan, jax.Array]:
        """See `Policy.executed_plans`."""
        return path if carry.plans is None else carry.plans.now, carry.clocks.clock_s

    def _build_order(self, path: Plan, inputs: PolicyInput) -> PassingOrder | None:
        if not self.keeps_order:
            return None
        return order.build_order(path, guidance.reach_m(inputs.params.vehicle_model.radius_m))

    def _replan_if_due(
        self,
        settings: Replanning,
        carry: ReplanningMemory,
        inputs: PolicyInput,
        key: jax.Array,
        step: jax.Array,
    ) -> ReplanningMemory:
        """Make plans and take them up in the steps where that is due."""
        makes, takes = replanning.check_schedule(settings, step)
        cruise = inputs.params.cruise_speed_mps

        def make(carry: ReplanningMemory) -> ReplanningMemory:
            plans = replanning.replan(settings, _require_plans(carry), carry.clocks, inputs, key)
            return replace(carry, plans=plans)

        def take(carry: ReplanningMemory) -> ReplanningMemory:
            plans, clocks = replanning.take_up(_require_plans(carry), carry.clocks, cruise)
            order, status = self._build_order(plans.now, inputs), carry.status
            if status is not None:
                status = guidance.shift_status(status, carry.clocks.clock_s, clocks.clock_s)
            return replace(carry, clocks=clocks, order=order, status=status, plans=plans)

        # Those that were a whole period on their way are taken up before others take their place.
        parts = [(makes, make), (takes, take)]
        for is_due, part in reversed(parts) if settings.delay else parts:
            carry = jax.lax.cond(is_due, part, lambda carry: carry, carry)
        return carry


def _require_plans(carry: ReplanningMemory) -> FleetPlans:
    if carry.plans is None:
        raise RuntimeError("plans are made anew by a policy that keeps none")
    return carry.plans
