"""The policy that flies plans online: in the order that they pass in, and made anew on the way."""

from dataclasses import dataclass, field, replace

import jax

from angler_mjx.errors import ConfigError
from angler_mjx.planning.online import guidance, order, replanning
from angler_mjx.planning.online.guidance import Heard, PlanProgress, PlanStatus
from angler_mjx.planning.online.order import PassingOrder
from angler_mjx.planning.online.replanning import FleetPlans, Replanning
from angler_mjx.robot.control.commands import Estimate, PoseTarget
from angler_mjx.robot.control.laws.follow import FollowCarry, FollowGains
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy, PolicyInput


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ReplanningMemory:
    """Of one world."""

    clocks: FollowCarry
    """[R]"""
    order: PassingOrder | None
    standing: PlanStatus | None
    """Who is waited for no longer, where order is kept."""
    plans: FleetPlans | None
    """Where they are made anew; otherwise the world's own are flown."""
    progress: PlanProgress | None = None
    """Of each, for others to hear, where order is kept by acoustics."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Online(Policy):
    """Guides a team along its plans by poses, as the guidance of the cascade does."""

    gains: FollowGains = field(default_factory=FollowGains)
    dt_s: float = field(default=0.05, metadata={"static": True})
    """Control period."""
    keeps_order: bool = field(default=False, metadata={"static": True})
    """Whether robots wait for those who are to pass first."""
    replanning: Replanning | None = field(default=None, metadata={"static": True})
    knows: Information | None = field(default=None, metadata={"static": True})
    looks: int = field(default=1, metadata={"static": True})
    ahead_s: float = field(default=0.0, metadata={"static": True})

    def reset(self, known: PolicyInput, key: jax.Array) -> ReplanningMemory:
        """See `Policy.reset`.

        Raises:
            ConfigError: plans are to be made anew, and the world's are no way-points.
        """
        plans = None
        if self.replanning is not None:
            if not isinstance(known.path, Trajectory):
                raise ConfigError(
                    f"planner.replan_hz: the plans at the start are {type(known.path).__name__}s; "
                    "replanning goes on from a Trajectory"
                )
            plans = replanning.begin(self.replanning, known)
        path = known.path if plans is None else plans.now
        clocks = guidance.begin(known.belief.q)
        return ReplanningMemory(
            clocks=clocks,
            order=self._order(path, known),
            standing=guidance.moving(clocks.clock_s) if self.keeps_order else None,
            plans=plans,
            progress=self._begun(known, clocks),
        )

    def _begun(self, known: PolicyInput, clocks: FollowCarry) -> PlanProgress | None:
        if known.others is None:
            return None
        if self.replanning is not None:
            raise ConfigError(
                "planner.replan_hz: a team is planned for from where all robots are, and acoustics "
                'do not tell that to anybody; leave it out, or take acoustics.model = "perfect"'
            )
        if not self.keeps_order:
            return None
        return guidance.progress(clocks.clock_s, None)

    def says(self, carry: ReplanningMemory) -> PlanProgress | None:
        """See `Policy.says`."""
        return carry.progress

    def act(
        self, carry: ReplanningMemory, known: PolicyInput, key: jax.Array, step: jax.Array
    ) -> tuple[ReplanningMemory, PoseTarget]:
        """See `Policy.act`."""
        if self.replanning is not None:
            carry = self._anew(self.replanning, carry, known, key, step)
        path = known.path if carry.plans is None else carry.plans.now
        estimate = Estimate(p=known.belief.p, q=known.belief.q, nu=known.belief.nu)
        cruise, heard = known.params.cruise_speed_mps, None
        if carry.progress is not None and known.others is not None:
            heard = Heard(others=known.others, time_s=known.time_s)
        clocks, target, standing = guidance.step(
            self.gains,
            carry.clocks,
            estimate,
            path,
            carry.order,
            cruise,
            self.dt_s,
            carry.standing,
            heard,
        )
        said = None
        if heard is not None:
            passed = guidance.passed_s(carry.clocks, estimate, path, cruise)
            said = guidance.progress(passed, carry.standing)
        return replace(carry, clocks=clocks, standing=standing, progress=said), target

    def flown(self, carry: ReplanningMemory, path: Plan) -> tuple[Plan, jax.Array]:
        """See `Policy.flown`."""
        return path if carry.plans is None else carry.plans.now, carry.clocks.clock_s

    def _order(self, path: Plan, known: PolicyInput) -> PassingOrder | None:
        if not self.keeps_order:
            return None
        return order.of(path, guidance.reach_m(known.params.known.radius_m))

    def _anew(
        self,
        settings: Replanning,
        carry: ReplanningMemory,
        known: PolicyInput,
        key: jax.Array,
        step: jax.Array,
    ) -> ReplanningMemory:
        """Make plans, and take them up, in the steps in which that is due."""
        makes, takes = replanning.due(settings, step)
        cruise = known.params.cruise_speed_mps

        def make(carry: ReplanningMemory) -> ReplanningMemory:
            plans = replanning.make(settings, _of(carry), carry.clocks, known, key)
            return replace(carry, plans=plans)

        def take(carry: ReplanningMemory) -> ReplanningMemory:
            plans, clocks = replanning.take_up(_of(carry), carry.clocks, cruise)
            order, standing = self._order(plans.now, known), carry.standing
            if standing is not None:
                standing = guidance.begun_anew(standing, carry.clocks.clock_s, clocks.clock_s)
            return replace(carry, clocks=clocks, order=order, standing=standing, plans=plans)

        # Those that were a whole period on their way are taken up before others take their place.
        parts = [(makes, make), (takes, take)]
        for is_due, part in reversed(parts) if settings.delay else parts:
            carry = jax.lax.cond(is_due, part, lambda carry: carry, carry)
        return carry


def _of(carry: ReplanningMemory) -> FleetPlans:
    if carry.plans is None:
        raise RuntimeError("plans are made anew by a policy that keeps none")
    return carry.plans
