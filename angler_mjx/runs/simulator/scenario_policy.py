"""Policy of a scenario: one by name, or passing order and replanning in flight."""

from collections.abc import Callable
from dataclasses import replace

from angler_mjx.errors import ConfigError
from angler_mjx.planning.device_planner import build_device_planner
from angler_mjx.planning.mppi.costs import Weights
from angler_mjx.planning.mppi.policy import Mppi
from angler_mjx.planning.online.host_replanner import HostReplanner
from angler_mjx.planning.online.policy import Online
from angler_mjx.planning.online.replanning import Replanning
from angler_mjx.planning.problem import Problem, ProblemSettings
from angler_mjx.planning.reach.policy import Reach
from angler_mjx.planning.register import PlannerSpec, plans_joints
from angler_mjx.planning.routes.policy import AlongRoutes
from angler_mjx.robot.control import stack
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import EndEffectorTarget
from angler_mjx.robot.control.laws.follow import FollowGains
from angler_mjx.runs.simulator.world_preparation import problem_settings
from angler_mjx.scenario.policy_tables import default_information
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy


def resolve_policy(scenario: Scenario, policy: Policy | None) -> Policy | None:
    """Return the policy that commands the robots of a scenario.

    Args:
        scenario: may name a policy, a passing order or replanning.
        policy: of the caller; it replaces an order that auto chose.

    Raises:
        ConfigError: both command the robots, or the planner cannot replan.
    """
    if policy is not None and scenario.keeps_order_by_auto:
        return policy
    if not scenario.flown:
        if policy is None and scenario.task_spec() is not None:
            raise ConfigError(
                f"task.type = {scenario.task.type!r}: plans lead to one goal, not from "
                "position to position; leave policy.name out, or give a policy of your own"
            )
        return policy
    if policy is not None:
        key = "planner.replan_hz" if scenario.planner.replan_hz else 'execution.order = "kept"'
        if not scenario.online:
            key = f'policy.name = "{scenario.policy.name}"'
        raise ConfigError(
            f"policy {type(policy).__name__}: the scenario's {key} commands the robots already; "
            "leave out one of them"
        )
    if scenario.online:
        return build_online_policy(scenario)
    if scenario.policy.file is not None:
        return scenario.policy.build_of_file()
    builders = {"routes": build_routes_policy, "reach": build_reach_policy, "mppi": build_mppi}
    return builders[scenario.policy.name](scenario)


def build_reach_policy(scenario: Scenario) -> Reach:
    """Build the policy that places end effectors, with a scenario's settings."""
    stages, _ = scenario.controller.stack()
    return Reach(
        begin_m=scenario.policy.reach.begin_m,
        stages=stack.find_entry(stages, EndEffectorTarget) + 1,
    )


def build_routes_policy(scenario: Scenario) -> AlongRoutes:
    """Build the policy along routes with a scenario's settings."""
    settings = scenario.policy.routes
    period = settings.period(scenario.time)
    return AlongRoutes(
        dt_s=scenario.time.control_dt_s,
        horizon_s=settings.horizon_s,
        routes_margin_m=scenario.planner.margin_m,
        period=period,
        observation_period=period,
        information=_policy_information(scenario),
    )


def build_mppi(scenario: Scenario) -> Mppi:
    """Build path integral control with a scenario's settings."""
    settings, time = scenario.policy.mppi, scenario.time
    return Mppi(
        weights=Weights(**settings.weights),
        density_kgpm3=scenario.water.density_kgpm3,
        gravity_mps2=scenario.sim_spec().water.gravity_mps2,
        output=settings.output,
        samples=settings.samples,
        horizon_s=settings.horizon_s,
        dt_s=settings.dt_s,
        knots=settings.knots,
        period=settings.period(time),
        information=_policy_information(scenario),
        ahead_s=settings.horizon_s,
    )


def _policy_information(scenario: Scenario) -> Information:
    """Return the information level of the policy that the scenario names."""
    return (
        scenario.policy.information or default_information(scenario.policy, scenario.planner)
    ).to_information()


def build_online_policy(scenario: Scenario) -> Online:
    """Build the policy that follows the plans of a scenario online.

    Raises:
        ConfigError: the planner cannot replan.
    """
    _, gains = scenario.controller.stack()
    follow_gains = gains[0] if isinstance(gains[0], FollowGains) else FollowGains()
    dt_s, settings = scenario.time.control_dt_s, _replanning_settings(scenario)
    return Online(
        gains=follow_gains,
        dt_s=dt_s,
        keeps_order=scenario.execution.order == "kept",
        replanning=settings,
        information=None if settings is None else settings.problem.information,
        observation_period=1 if settings is None else settings.every,
        ahead_s=0.0 if settings is None else scenario.time.horizon_s,
    )


def _replanning_settings(scenario: Scenario) -> Replanning | None:
    planner, time = scenario.planner, scenario.time
    if planner.replan_hz == 0.0:
        return None
    spec = planner.planner_spec()
    problem = replace(
        problem_settings(scenario, planner.information.to_information()),
        deadline_s=_deadline_s(scenario, spec),
        is_replan=True,
    )
    return Replanning(
        planner=_build_replanner(scenario, spec, problem),
        every=round(1.0 / (planner.replan_hz * time.control_dt_s)),
        delay=round(planner.delay_s / time.control_dt_s),
        dt_s=time.control_dt_s,
        problem=problem,
    )


def _build_replanner(
    scenario: Scenario, spec: PlannerSpec, problem: ProblemSettings
) -> Callable[[Problem], Trajectory]:
    if spec.reference.on_device:
        return build_device_planner(spec, problem)
    return _build_host_replanner(scenario, spec)


def _build_host_replanner(scenario: Scenario, spec: PlannerSpec) -> HostReplanner:
    name, rate = spec.reference.name, f"planner.replan_hz = {scenario.planner.replan_hz:g}"
    if scenario.tile != 1:
        raise ConfigError(
            f"{rate}: planner {name} plans on the host, and batches of worlds are planned for on "
            "the device in flight: take grid, priority, current or a class with plan_batch, leave "
            "out replan_hz, or fly one scene with angler fly (or one world at a time: tile = 1)"
        )
    if plans_joints(spec):
        raise ConfigError(
            f"{rate}: planner {name} gives headings (JointTrajectory), and replanning goes on from "
            "way-points; leave out its heading, or replan_hz"
        )
    settings = tuple(sorted(spec.settings.items()))
    return HostReplanner(
        reference=spec.reference, settings=settings, points=scenario.planner.points
    )


def _deadline_s(scenario: Scenario, spec: PlannerSpec) -> float:
    """Return the time limit [s] of a plan; on the host it ends when the plan is due."""
    planner = scenario.planner
    if spec.reference.on_device:
        return planner.deadline_s
    return min(planner.deadline_s, planner.delay_s or 1.0 / planner.replan_hz)
