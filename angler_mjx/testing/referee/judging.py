"""Judgement of a robot with every control step stored: its whole episode is recomputed."""

from dataclasses import dataclass

import numpy as np

from angler_mjx.testing.referee import findings as say
from angler_mjx.testing.referee.collecting import FindingCollector
from angler_mjx.testing.referee.contacts import OBSTACLE, ROBOT, STILL
from angler_mjx.testing.referee.findings import CheckMethod, FindingResult, RefereeFinding
from angler_mjx.testing.referee.geometry import Floats
from angler_mjx.testing.referee.scene import RefereeEpisode, RefereeScene

HALF_US = 0.5
"""Uncertainty of a command that was stored as whole microseconds."""


@dataclass(frozen=True, kw_only=True)
class JudgedEnd:
    """End of a robot as judged by the referee."""

    outcome: str
    state: int
    result: FindingResult
    note: str
    how: CheckMethod = "exact"
    """Method of the check."""


def judge_exact(scene: RefereeScene, robot: int, stored: int) -> list[RefereeFinding]:
    """Return the findings of one robot.

    Args:
        scene: its world.
        robot: its index.
        stored: the state of its end by the results; 0 if there is no such state.
    """
    episode = RefereeEpisode(scene, robot)
    end = _judge_end(scene, episode, stored)
    collector = FindingCollector(scene, robot)
    end_s = float(scene.world.step[end.state]) * scene.run.control_dt_s
    collector.add_verdict(
        "outcome", end.how, scene.stored_outcome(robot), end.outcome, end.result, end.note
    )
    collector.time(end_s, end.how, end.result, end.note)
    collector.number("path_length_m", float(scene.path_m[end.state, robot]), say.PATH_M)
    _check_energy(collector, scene, robot, end.state)
    nearby = scene.near_until(robot, end.state)
    tolerance = max(say.CLEARANCE_M, scene.contact_band_m)
    collector.number("min_clearance_m", nearby.clearance_m(robot, end.state), tolerance)
    collector.number("min_separation_m", nearby.separation_m(robot, end.state), tolerance)
    if scene.run.has_contacts:
        collector.touch(end.state)
    else:
        _check_contact(collector, scene, episode, end)
    collector.set_position(end.outcome, scene.world.p[end.state, robot])
    collector.record(end.state)
    collector.task()
    collector.carry(end.state)
    return collector.findings


def _judge_end(scene: RefereeScene, episode: RefereeEpisode, stored: int) -> JudgedEnd:
    """Return the stored end where the record agrees or rounding allows it; else the referee's."""
    robot, outcome = episode.robot, scene.stored_outcome(episode.robot)
    last = int(scene.last[robot])
    first = episode.first(last)
    horizon = outcome == "timeout" and _is_the_end(scene, stored)
    if stored < 1:
        return _referee_end(episode, first, last)
    if horizon and first is None:
        return JudgedEnd(outcome=outcome, state=stored, result="agrees", note="")
    if first == stored and episode.outcome(stored) == outcome:
        return JudgedEnd(outcome=outcome, state=stored, result="agrees", note="")
    if outcome == "diverged" and first in (None, stored) and _is_held(scene, robot, stored):
        note = "the state that was none is not stored; the robot was held before it"
        return JudgedEnd(outcome=outcome, state=stored, result="agrees", note=note, how="unchecked")
    if first in (None, stored) and _is_unseen_end(scene, episode, stored):
        note = "no trajectory shows when a task is done, or when a robot or a grip breaks"
        return JudgedEnd(outcome=outcome, state=stored, result="agrees", note=note, how="bounded")
    goes_on = all("running" in episode.possible_outcomes(k) for k in range(first or stored, stored))
    allowed = episode.possible_outcomes(stored)
    if stored <= last and goes_on and (outcome in allowed or (horizon and "running" in allowed)):
        state = stored if first is None else min(first, stored)
        # A difference by rounding is reported with its number, and the rest is judged by the
        # stored end.
        return JudgedEnd(
            outcome=outcome, state=stored, result="undecided", note=episode.numbers(state)
        )
    return _referee_end(episode, first, last)


def _referee_end(episode: RefereeEpisode, first: int | None, last: int) -> JudgedEnd:
    """Return the end as judged by the referee, different from the results."""
    state = last if first is None else first
    return JudgedEnd(
        outcome=episode.outcome(state), state=state, result="disagrees", note=episode.numbers(state)
    )


def _is_the_end(scene: RefereeScene, state: int) -> bool:
    final = len(scene.world.step) - 1
    full = int(scene.world.step[-1]) >= scene.run.horizon_steps
    return state == final and (full or scene.run.is_single_scene)


def _is_unseen_end(scene: RefereeScene, episode: RefereeEpisode, state: int) -> bool:
    """Return whether a robot's outcome can come with a state that does not show it.

    Contact and leaving the region come first.
    """
    still_running = {"running", "reached"} & episode.possible_outcomes(state)
    unseen = scene.unseen(int(scene.world.step[state]))
    return bool(still_running) and scene.stored_outcome(episode.robot) in unseen


def _is_held(scene: RefereeScene, robot: int, state: int) -> bool:
    """Return whether a robot's position in a state equals that in the state before."""
    world = scene.world
    stands = np.array_equal(world.p[state, robot], world.p[state - 1, robot])
    return state > 0 and stands and not world.nu[state, robot].any()


def _check_energy(collector: FindingCollector, scene: RefereeScene, robot: int, last: int) -> None:
    """Check the energy: power of every command until the end, for a control period each."""
    pwm, dt = scene.world.pwm_us[:last, robot], scene.run.control_dt_s
    thrusters = scene.run.robot(robot, collector.row)
    servos, count = thrusters.servos, thrusters.alive.size
    signals = np.concatenate([pwm[:, :count], pwm[:, servos.columns]], axis=1)
    if len(pwm) < last or not np.all(np.isfinite(signals) & (signals > 0.0)):
        collector.unchecked("energy_j", "a step has no command in the record")
        return
    moved_j = servos.energy_j(pwm, dt, scene.run.physics_dt_s)
    judged = float(np.sum(thrusters.power(pwm)) * dt) + moved_j
    tolerance = max(say.ENERGY_FRACTION * judged, say.ENERGY_J)
    if not scene.run.whole_us:
        collector.number("energy_j", judged, tolerance, relative=True)
        return
    low, high = (float(np.sum(x) * dt) + moved_j for x in thrusters.power_bounds(pwm, HALF_US))
    tolerance += servos.rounding_w(HALF_US) * len(pwm) * dt
    collector.add_bounded("energy_j", low - tolerance, high + tolerance, "commands are whole us")


def _check_contact(
    collector: FindingCollector, scene: RefereeScene, episode: RefereeEpisode, end: JudgedEnd
) -> None:
    """Check the collision partner and the impact speed."""
    if not end.outcome.startswith("collision"):
        collector.add_no_contact("exact")
        return
    nearby = episode.touched_pairs(end.state, 2.0 * scene.contact_band_m)
    pairs = list(zip(nearby.kind.tolist(), nearby.index.tolist(), strict=True))
    names = [scene.name(kind, index) for kind, index in pairs]
    stored = collector.row["failure_pair"]
    result: FindingResult = "disagrees"
    if stored in names:
        result = "agrees" if stored == names[0] else "undecided"
    gaps = ", ".join(f"{n} {g:.3g} m" for n, g in zip(names, nearby.gap_m, strict=True))
    collector.add_verdict("failure_pair", "exact", stored, names[0], result, gaps)
    touched = pairs[names.index(stored) if stored in names else 0]
    velocity = scene.velocity(end.state, episode.robot)
    other, error = _other_velocity(scene, end.state, *touched)
    judged = float(np.linalg.norm(velocity - other))
    if error == 0.0:
        collector.number("impact_speed_mps", judged, say.IMPACT_MPS)
    else:
        error += say.IMPACT_MPS
        why = "an obstacle's velocity is that of its positions beside the touch"
        collector.add_bounded("impact_speed_mps", judged - error, judged + error, why)


def _other_velocity(scene: RefereeScene, state: int, kind: int, index: int) -> tuple[Floats, float]:
    """Return the velocity [3] of the collision partner, m/s in W, and its uncertainty."""
    world, dt = scene.world, scene.run.control_dt_s
    if kind == ROBOT:
        return scene.velocity(state, index), 0.0
    if kind != OBSTACLE or world.environment["obstacles/motion"][index] == STILL:
        return np.zeros(3), 0.0
    beside = range(max(state - 2, 0), min(state + 2, len(world.step)))
    mean = np.diff(world.obstacle_p[list(beside), index], axis=0) / dt
    before = min(state, 2)
    # The mean velocities of the steps before and after; at the end, of the last two steps.
    velocities = mean[before - 1 : before + 1] if len(mean) > before else mean[-2:]
    spread = float(np.linalg.norm(velocities[0] - velocities[-1]))
    return np.mean(velocities, axis=0), spread + 2.0 * scene.ulp_m / dt
