"""Judgement of a robot with only some stored states of its episode, by the bounds that they set."""

import numpy as np

from angler_mjx.testing.referee import findings as say
from angler_mjx.testing.referee.collecting import FindingCollector
from angler_mjx.testing.referee.contacts import STILL
from angler_mjx.testing.referee.findings import FindingResult, RefereeFinding
from angler_mjx.testing.referee.record import OUTCOMES
from angler_mjx.testing.referee.scene import FAILED, RefereeEpisode, RefereeScene

SPARSE = "what was between the samples is not known"


def judge_bounded(scene: RefereeScene, robot: int) -> list[RefereeFinding]:
    """Return the findings of one robot."""
    collector, episode = FindingCollector(scene, robot), RefereeEpisode(scene, robot)
    step, outcome = scene.stored_step[robot], scene.stored_outcome(robot)
    world = scene.world
    if step is None or step < 1 or outcome not in OUTCOMES or outcome == "running":
        collector.add_verdict(
            "outcome", "bounded", outcome, "none", "disagrees", "no such end can be"
        )
        step = int(world.step[min(int(scene.ended[robot]), len(world.step) - 1)])
    else:
        _check_outcome(collector, scene, episode, step)
    _check_time(collector, scene, robot, step)
    before = int(np.searchsorted(world.step, step, side="right")) - 1
    after = min(int(np.searchsorted(world.step, step)), len(world.step) - 1)
    # A failed robot stays at the end position of its episode: the next sample shows it.
    held = after if outcome in FAILED and world.step[after] >= step else before
    _check_numbers(collector, scene, episode, step, before, held)
    if scene.run.has_contacts:
        collector.touch(before)
    else:
        state = held if world.step[held] >= step else None
        _check_contact(collector, scene, episode, state, outcome)
    shown = held if world.step[held] == step or held > before else None
    if outcome == "reached" or shown is not None:
        collector.set_position(outcome, world.p[held, robot])
    else:
        collector.unchecked("failure_place_m", SPARSE)
    collector.record(int(np.searchsorted(world.step, step)))
    collector.task()
    collector.carry(after if world.step[after] == step else before)
    return collector.findings


def _check_outcome(
    collector: FindingCollector, scene: RefereeScene, episode: RefereeEpisode, step: int
) -> None:
    """Check that no state before the end ends the episode, and that one at the end allows it."""
    robot, stored = episode.robot, scene.stored_outcome(episode.robot)
    world = scene.world
    shown = [k for k in range(1, len(world.step)) if world.step[k] < step]
    for state in shown:
        if state <= scene.last[robot] and "running" not in episode.possible_outcomes(state):
            judged, note = episode.outcome(state), episode.numbers(state)
            collector.add_verdict("outcome", "bounded", stored, judged, "disagrees", note)
            return
    if stored in ("failed", "damaged", "dropped") and stored not in scene.unseen(step):
        collector.add_verdict(
            "outcome", "bounded", stored, "running", "disagrees", "none breaks down then"
        )
        return
    after = int(np.searchsorted(world.step, step))
    if after < len(world.step) and not _allows_outcome(scene, episode, after, step, stored):
        note = episode.numbers(after)
        collector.add_verdict(
            "outcome", "bounded", stored, episode.outcome(after), "disagrees", note
        )
        return
    collector.add_verdict("outcome", "bounded", stored, stored, "agrees", SPARSE)


def _allows_outcome(
    scene: RefereeScene, episode: RefereeEpisode, state: int, step: int, stored: str
) -> bool:
    """Return whether the first stored state at or after the end allows the stored outcome."""
    if scene.world.step[state] == step:
        expected = {"running"} if stored == "timeout" else {stored}
        if stored in scene.unseen(step):
            expected = {"running", "reached"}
        return stored == "diverged" or not expected.isdisjoint(episode.possible_outcomes(state))
    # The robot has stood there since: still objects are where they were, moving ones are not.
    static_gap_m = episode.static_gap_m(state)
    if stored == "collision_static":
        return static_gap_m <= scene.contact_band_m
    outside = scene.outside_m[state, episode.robot] > -scene.position_band_m
    return stored != "out_of_bounds" or (outside and static_gap_m >= -scene.contact_band_m)


def _check_time(collector: FindingCollector, scene: RefereeScene, robot: int, step: int) -> None:
    """Check the end time: between the last running sample and the first that is not."""
    world, dt = scene.world, scene.run.control_dt_s
    ended = int(scene.ended[robot])
    low = float(world.step[min(ended, len(world.step)) - 1]) * dt if ended else 0.0
    high = float(world.step[ended]) * dt if ended < len(world.step) else None
    stored = scene.stored_end_s(robot)
    is_timeout = scene.stored_outcome(robot) == "timeout"
    slack = 1e-6 * max(1.0, low)
    if high is None:
        high = scene.run.horizon_steps * dt if is_timeout else low + scene.run.every * dt
    fits: FindingResult = "agrees" if low - slack <= stored <= high + slack else "disagrees"
    span = f"{low:.6g} to {high:.6g}"
    collector.add_verdict("end_time_s", "bounded", stored, span, fits, SPARSE)


def _check_numbers(
    collector: FindingCollector,
    scene: RefereeScene,
    episode: RefereeEpisode,
    step: int,
    before: int,
    held: int,
) -> None:
    run, robot = scene.run, episode.robot
    row = scene.rows[robot]
    min_path_m = float(scene.path_m[held, robot]) - say.PATH_M
    collector.add_bounded(
        "path_length_m", min_path_m, float("inf"), "no way is shorter than straight lines"
    )
    thrusters = run.robots[robot]
    max_w = float(thrusters.power_w.max() * thrusters.alive.sum() + thrusters.servos.power_w.sum())
    max_energy_j = max_w * step * run.control_dt_s
    if np.isnan(float(row["energy_j"])) and scene.stored_outcome(robot) == "diverged":
        collector.unchecked("energy_j", "a robot that diverged had no last command")
    else:
        collector.add_bounded(
            "energy_j",
            0.0,
            max_energy_j * (1.0 + say.ENERGY_FRACTION),
            "at full power all the time",
        )
    band = max(say.CLEARANCE_M, scene.contact_band_m)
    touched, outcome = str(row["failure_pair"]), scene.stored_outcome(robot)
    by_robot = touched.startswith("robot")
    by_thing = touched != "none" and not by_robot
    nearby = scene.near_until(robot, before)
    clearance = nearby.clearance_m(robot, before)
    if held > before:
        clearance = min(clearance, episode.static_gap_m(held))
    for name, sampled, is_hit in (
        ("min_clearance_m", clearance, by_thing),
        ("min_separation_m", nearby.separation_m(robot, before), by_robot),
    ):
        if np.isinf(sampled):
            collector.number(name, sampled, 0.0)
            continue
        # Without contact there is no overlap; with contact several objects may overlap.
        touches = outcome.startswith("collision") or outcome == "diverged" or run.has_contacts
        high = min(sampled, 0.0) if is_hit else sampled
        collector.add_bounded(
            name, -np.inf if touches else -band, high + band, "no more than in a sample"
        )


def _check_contact(
    collector: FindingCollector,
    scene: RefereeScene,
    episode: RefereeEpisode,
    held: int | None,
    outcome: str,
) -> None:
    """Check the collision partner; ``held`` is a state with the robot's end position, if any."""
    if not outcome.startswith("collision"):
        collector.add_no_contact("exact")
        return
    stored = str(collector.row["failure_pair"])
    kind, _, number = stored.partition(":")
    motion = scene.world.environment["obstacles/motion"]
    still = kind in ("cell", "floor")
    if kind == "obstacle" and number.isdecimal() and int(number) < len(motion):
        still = bool(motion[int(number)] == STILL)
    if held is None or not still:
        collector.unchecked("failure_pair", "no sample shows both as they were at the touch")
    else:
        nearby = episode.touched_pairs(held, 2.0 * scene.contact_band_m + 1.0)
        names = [
            scene.name(k, i)
            for k, i, gap in zip(nearby.kind, nearby.index, nearby.gap_m, strict=True)
            if gap <= scene.contact_band_m
        ]
        fits: FindingResult = "agrees" if stored in names else "disagrees"
        judged = names[0] if names else "none"
        collector.add_verdict("failure_pair", "bounded", stored, judged, fits, SPARSE)
    collector.unchecked("impact_speed_mps", "robots that have failed are stored at rest")
