"""The referee's rules, on flights of which every number is known in closed form."""

import hashlib
import json
import shutil

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.testing import referee
from angler_mjx.testing.referee import vehicles

from .hand_made import (
    DT_S,
    OUTCOMES,
    Ball,
    Flight,
    edit_array,
    edit_rows,
    replace,
    row,
    straight,
    write,
)

STEPS = 40
FRONT, SIDE, BELOW = 0.1015 + 0.127, 0.1605 + 0.127, 0.011 + 0.127
"""Half the Heavy's length and width, and how far it reaches below its centre of mass."""
CAP = 1.5 - (np.hypot(np.hypot(0.1015, 0.1605), 0.011) + 0.127)
WATTS = 12.8
"""Of a T200 at 1600 us and 16 V, by its table."""
FAR = (5.0, 5.0, -11.0)


def joined(*robots):
    return [np.concatenate(part, axis=1) for part in zip(*robots, strict=True)]


def flight(robots, outcomes, ends, rows, goals=None, **more):
    """Robots with the state that ended each; rows are filled with what all have in common."""
    p, nu, q = joined(*robots)
    outcome = np.zeros(p.shape[:2], int)
    for i, (name, end) in enumerate(zip(outcomes, ends, strict=True)):
        outcome[end:, i] = 0 if name == "timeout" else OUTCOMES[name]
    pwm = np.full((STEPS, len(robots), 8), 1600.0)
    whole = [
        row(
            name,
            end * DT_S,
            p[end, i],
            energy_j=8 * WATTS * end * DT_S,
            path_length_m=float(np.linalg.norm(p[end, i] - p[0, i])),
            **rows[i],
        )
        for i, (name, end) in enumerate(zip(outcomes, ends, strict=True))
    ]
    goal = np.array([FAR] * len(robots) if goals is None else goals)
    return Flight(p=p, nu=nu, q=q, pwm=pwm, outcome=outcome, goal=goal, rows=whole, **more)


def past_a_rock():
    """Along x beside the cell x and y 0 to 1.5, z -6 to -4.5; 0.2 m from it."""
    start = (-0.5, -SIDE - 0.2, -5.0)
    robot = straight(start, (1.0, 0.0, 0.0), STEPS)
    rows = [{"min_clearance_m": 0.2}]
    return flight([robot], ["timeout"], [STEPS], rows, rock=((4, 4, 4),))


def into_a_rock():
    """Head on, into the same cell: 0.9 m before it at first, 5 cm a step."""
    robot = straight((-0.9 - FRONT, 0.7, -5.0), (1.0, 0.0, 0.0), STEPS, end=18)
    # 18 steps are 0.9 m: a touch by rounding. A little nearer, so that it is one.
    robot[0][..., 0] += 0.01
    found = {"min_clearance_m": -0.01, "failure_pair": "cell", "impact_speed_mps": 1.0}
    return flight([robot], ["collision_static"], [18], [found], rock=((4, 4, 4),))


def into_each_other():
    """Two that meet at 1.5 m/s; the first one's end is the second one's."""
    gap = 1.0
    one = straight((-gap / 2 - FRONT, 0.0, -5.0), (1.0, 0.0, 0.0), STEPS, end=14)
    other = straight((gap / 2 + FRONT, 0.0, -5.0), (-0.5, 0.0, 0.0), STEPS, end=14)
    rows = [
        {
            "min_clearance_m": CAP,
            "min_separation_m": gap - 14 * 0.075,
            "failure_pair": f"robot:{i}",
            "impact_speed_mps": 1.5,
        }
        for i in (1, 0)
    ]
    return flight([one, other], ["collision_robot"] * 2, [14, 14], rows)


def into_a_ball():
    """A ball that comes with 0.4 m/s, up to a robot that stands."""
    robot = straight((0.0, 0.0, -5.0), (0.0, 0.0, 0.0), STEPS, end=26)
    gap = 0.51
    ball = Ball((FRONT + 0.5 + gap, 0.0, -5.011), v_mps=(-0.4, 0.0, 0.0))
    found = {
        "min_clearance_m": gap - 26 * 0.02,
        "failure_pair": "obstacle:0",
        "impact_speed_mps": 0.4,
    }
    return flight([robot], ["collision_dynamic"], [26], [found], balls=(ball,))


def to_a_goal():
    """Arrives with its tolerance, and goes on."""
    robot = straight((0.0, 0.0, -5.0), (0.5, 0.0, 0.0), STEPS)
    found = {"min_clearance_m": CAP}
    return flight([robot], ["reached"], [29], [found], goals=[(1.01, 0.0, -5.0)])


def through_the_top():
    robot = straight((0.0, 0.0, -0.49), (0.0, 0.0, 1.0), STEPS, end=10)
    return flight([robot], ["out_of_bounds"], [10], [{"min_clearance_m": CAP}])


def through_the_bottom():
    """The floor is half a metre below the region."""
    robot = straight((0.0, 0.0, -11.77), (0.0, 0.0, -0.5), STEPS, end=10)
    lowest = -11.77 - 0.25 - BELOW + 12.5
    return flight([robot], ["out_of_bounds"], [10], [{"min_clearance_m": lowest}])


def arrives_and_collides():
    """Into the rock in the step in which it is near enough to its goal: a collision."""
    made = into_a_rock()
    return replace(made, goal=made.p[18] + [[0.26, 0.0, 0.0]])


FLIGHTS = {
    one.__name__: one
    for one in (
        past_a_rock,
        into_a_rock,
        into_each_other,
        into_a_ball,
        to_a_goal,
        through_the_top,
        through_the_bottom,
        arrives_and_collides,
    )
}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A copy of a run that was written once, as often as one is wanted."""
    kept = {}

    def copy(place, make, **how):
        key = (make.__name__, *how.items())
        if key not in kept:
            kept[key] = write(tmp_path_factory.mktemp("run") / "run", make(), **how)
        return shutil.copytree(kept[key], place / "run")

    return copy


def wrong(verdict):
    """Quantities that disagree."""
    return {one.quantity for one in verdict.differences if one.result == "disagrees"}


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_flight_known_in_closed_form_agrees(name, tmp_path):
    verdict = referee.judge(write(tmp_path / "run", FLIGHTS[name]()))
    assert verdict.differences == []
    robots = verdict.robots
    for quantity, count in verdict.counts.items():
        if quantity != "impact_speed_mps" or name != "into_a_ball":
            assert count.exact == robots, quantity
    assert verdict.counts["path_length_m"].largest < 1e-5
    assert verdict.counts["min_clearance_m"].largest < 1e-6


def breaks_down():
    """On its way, after 12 steps."""
    robot = straight((0.0, 0.0, -5.0), (0.5, 0.0, 0.0), STEPS, end=12)
    return flight([robot], ["failed"], [12], [{"min_clearance_m": CAP}])


@pytest.mark.parametrize("every", [1, 4, 10])
@pytest.mark.parametrize(
    ("table", "right"),
    [
        ({"fraction": 0.2, "earliest_s": 0.0, "latest_s": None}, True),
        ({"fraction": 0.2, "earliest_s": 12 * DT_S, "latest_s": 12 * DT_S}, True),
        ({"fraction": 0.2, "earliest_s": 11.2 * DT_S, "latest_s": 11.9 * DT_S}, True),
        ({"fraction": 0.2, "earliest_s": 12.2 * DT_S, "latest_s": None}, False),
        ({"fraction": 0.2, "earliest_s": 0.0, "latest_s": 10.9 * DT_S}, False),
        ({"fraction": 0.0, "earliest_s": 0.0, "latest_s": None}, False),
        (None, False),
    ],
)
def test_robots_break_down_where_and_when_the_scenario_lets_them(table, right, every, tmp_path):
    path = write(tmp_path / "run", breaks_down(), every=every)
    config = json.loads((path / "config.json").read_text())
    more = {} if table is None else {"breakdowns": table}
    (path / "config.json").write_text(json.dumps({**config, **more}))
    assert ("outcome" in wrong(referee.judge(path))) is not right


@pytest.mark.parametrize("every", [1, 4])
def test_a_goal_says_who_has_reached_where_there_is_no_task(every, tmp_path):
    """It flies past its goal, far from any rock, and has reached after 35 steps, not after 29.

    With a task it can (`test_referee_tasks.py`).
    """
    made = to_a_goal()
    outcome = made.outcome * 0
    outcome[35:] = OUTCOMES["reached"]
    path = write(tmp_path / "run", replace(made, outcome=outcome), every=every)
    edit_rows(
        path,
        0,
        0,
        time_to_goal_s=35 * DT_S,
        path_length_m=0.5 * 35 * DT_S,
        energy_j=8 * WATTS * 35 * DT_S,
    )
    config = json.loads((path / "config.json").read_text())
    (path / "config.json").write_text(json.dumps({**config, "task": {"type": "goal"}}))
    assert "outcome" in wrong(referee.judge(path))


def test_what_a_robot_touches_comes_before_its_breakdown(tmp_path):
    path = write(tmp_path / "run", replace(into_a_rock(), outcome=breaks_down().outcome))
    edit_array(path, "outcome", (0, slice(18, None)), lambda x: x * 0 + OUTCOMES["failed"])
    edit_array(path, "outcome", (0, slice(0, 18)), lambda x: x * 0)
    edit_rows(path, 0, 0, outcome="failed", failure_pair="none", impact_speed_mps=None)
    config = json.loads((path / "config.json").read_text())
    table = {"fraction": 1.0, "earliest_s": 0.0, "latest_s": None}
    (path / "config.json").write_text(json.dumps({**config, "breakdowns": table}))
    assert "outcome" in wrong(referee.judge(path))


def passes_its_goal():
    """To its goal, and over it within the horizon: `to_a_goal` of a plan that ends elsewhere."""
    made = to_a_goal()
    rows = row("timeout", STEPS * DT_S, made.p[STEPS, 0], min_clearance_m=CAP)
    rows |= {"energy_j": 8 * WATTS * STEPS * DT_S, "path_length_m": 0.5 * STEPS * DT_S}
    rows["passed_goal_early"] = True
    return replace(made, outcome=made.outcome * 0, rows=[rows])


@pytest.mark.parametrize("every", [1, 4])
def test_early_passes_are_counted_and_fit_the_distances_to_the_goal(every, tmp_path):
    """The pass is between 0.7 and 1 m along x: states 29 to 40, of which every fourth shows it."""
    path = write(tmp_path / "run", passes_its_goal(), every=every)
    verdict = referee.judge(path)
    assert verdict.passed_goal_early == 1
    assert not wrong(verdict)
    edit_rows(path, 0, 0, passed_goal_early=False)
    assert "outcome" in wrong(referee.judge(path))


def test_an_early_pass_far_from_the_goal_is_named(tmp_path):
    made = past_a_rock()
    rows = [{**made.rows[0], "passed_goal_early": True}]
    path = write(tmp_path / "run", replace(made, rows=rows))
    assert wrong(referee.judge(path)) == {"record"}


DAMAGE = {
    "outcome": {"outcome": "out_of_bounds"},
    "end_time_s": {"failure_time_s": 18 * DT_S + 1e-3},
    "path_length_m": {"path_length_m": 0.9 + 0.011},
    "energy_j": {"energy_j": 8 * WATTS * 18 * DT_S * 1.0011},
    "min_clearance_m": {"min_clearance_m": -0.01 + 1.2e-5},
    "min_separation_m": {"min_separation_m": 1.0},
    "failure_pair": {"failure_pair": "floor"},
    "impact_speed_mps": {"impact_speed_mps": 1.0002},
    "failure_place_m": {"failure_z_m": -5.001},
    "record": {"parameter_set": "blue_gazebo"},
}


@pytest.mark.parametrize("quantity", DAMAGE)
def test_a_damaged_result_is_named(quantity, stored, tmp_path):
    path = stored(tmp_path, into_a_rock, worlds=3)
    edit_rows(path, 1, 0, **DAMAGE[quantity])
    verdict = referee.judge(path)
    assert quantity in wrong(verdict)
    assert {one.world for one in verdict.differences} == {1}
    # An outcome that is no collision also leaves its pair and the samples' outcomes wrong.
    alone = {"outcome": {"outcome", "failure_pair", "impact_speed_mps", "record"}}
    assert wrong(verdict) <= alone.get(quantity, {quantity})


def test_a_robot_without_others_may_have_no_separation(stored, tmp_path):
    """Runs store nulls where there is no number; older ones stored infinity."""
    path = stored(tmp_path, into_a_rock)
    assert referee.judge(path).agrees
    edit_rows(path, 0, 0, min_separation_m=None)
    assert referee.judge(path).agrees


TILTED = [0.995, 0.0, 0.0, 0.0998]

STORED = {
    "a position": ("p_m", (0, 7, 0, 0), lambda x: x + 0.1, "path_length_m"),
    "the last position": ("p_m", (0, 18, 0, 0), lambda x: x - 0.02, "outcome"),
    "a command": ("pwm_us", (0, 5, 0, 3), lambda x: x + 100.0, "energy_j"),
    "an attitude": (
        "q",
        (0, 18, 0),
        lambda x: x * 0 + [0.995, 0.0, 0.0, 0.0998],
        "min_clearance_m",
    ),
    "the velocity of the touch": ("nu", (0, 18, 0, 0), lambda x: x * 1.01, "impact_speed_mps"),
    "an outcome beside a sample": ("outcome", (0, 12, 0), lambda x: x + 1, "record"),
    "a place after the end": ("p_m", (0, 30, 0, 1), lambda x: x + 0.01, "record"),
    "the rock": ("environment/grid/occupied", (0, 4, 4, 4), lambda x: x & False, "outcome"),
    "the floor": ("environment/floor_z_m", (0,), lambda x: x + 7.4, "outcome"),
    "the start": ("environment/start_m", (0, 0, 1), lambda x: x + 0.01, "record"),
}


@pytest.mark.parametrize("what", STORED)
def test_a_damaged_trajectory_is_named(what, stored, tmp_path):
    path = stored(tmp_path, into_a_rock)
    name, where, change, quantity = STORED[what]
    edit_array(path, name, where, change)
    assert quantity in wrong(referee.judge(path))


def test_the_last_state_decides_about_the_last_step(tmp_path):
    made = into_a_rock()
    ends = replace(
        made,
        p=made.p[:19],
        nu=made.nu[:19],
        q=made.q[:19],
        pwm=made.pwm[:18],
        outcome=made.outcome[:19],
    )
    assert referee.judge(write(tmp_path / "with", ends)).differences == []
    without = referee.judge(write(tmp_path / "without", ends, with_end=False))
    assert without.conclusion == "inconclusive"
    assert without.counts["outcome"].exact == 0
    assert without.counts["min_clearance_m"].bounded == 1
    assert without.counts["impact_speed_mps"].unchecked == 1


def test_a_touch_within_rounding_is_undecided_and_says_by_how_much(tmp_path):
    """The nose is 0.2 um before the rock in float64, and the run calls it a touch."""
    made = into_a_rock()
    p = made.p.copy()
    p[18:, 0, 0] = np.nextafter(np.float32(-FRONT), np.float32(-1.0)) - 2e-7
    row = {**made.rows[0], "min_clearance_m": 0.0, "failure_x_m": float(p[18, 0, 0])}
    row["path_length_m"] = float(np.linalg.norm(np.diff(p[:19, 0], axis=0), axis=1).sum())
    verdict = referee.judge(write(tmp_path / "run", replace(made, p=p, rows=[row])))
    assert verdict.conclusion == "inconclusive"
    (one,) = verdict.differences
    assert (one.quantity, one.result, one.judged) == ("outcome", "undecided", "collision_static")
    assert "e-07 m away" in one.note
    # A millimetre is no rounding.
    p[18:, 0, 0] -= 1e-3
    verdict = referee.judge(write(tmp_path / "wide", replace(made, p=p, rows=[row])))
    assert "outcome" in wrong(verdict)


def test_a_dead_thruster_and_padding_draw_nothing(tmp_path):
    made = to_a_goal()
    fleet = ({"vehicle": "bluerov2", "thruster_health": {"thruster_2": 0.0, "thruster_3": 0.5}},)
    one = {
        **made.rows[0],
        "vehicle": "bluerov2",
        "parameter_set": "blue_gazebo",
        "energy_j": 5 * WATTS * 29 * DT_S,
        "min_clearance_m": 1.5 - np.hypot(np.hypot(0.1015, 0.042), 0.011) - 0.127,
    }
    fleet[0]["parameter_set"] = "blue_gazebo"
    path = write(tmp_path / "run", replace(made, fleet=fleet, rows=[one]))
    found = {one.quantity for one in referee.judge(path).differences}
    assert found <= {"min_clearance_m"}  # its centre of mass lies elsewhere
    assert referee.judge(path).counts["energy_j"].largest < 1e-9


def test_commands_in_whole_us_only_bound_the_energy(tmp_path):
    made = to_a_goal()
    made = replace(made, pwm=made.pwm + 0.3)
    exact = 8 * (WATTS + 0.3 * (19.2 - 12.8) / 20.0) * 29 * DT_S
    path = write(tmp_path / "run", replace(made, rows=[{**made.rows[0], "energy_j": exact}]))
    assert referee.judge(path).counts["energy_j"].largest < 1e-5
    coarse = write(
        tmp_path / "coarse",
        replace(made, rows=[{**made.rows[0], "energy_j": exact}]),
        whole_us=True,
    )
    verdict = referee.judge(coarse)
    assert verdict.agrees
    assert verdict.counts["energy_j"].bounded == 1
    edit_rows(coarse, 0, 0, energy_j=exact * 1.03)
    assert wrong(referee.judge(coarse)) == {"energy_j"}


@pytest.mark.parametrize("name", FLIGHTS)
def test_of_sparse_samples_it_claims_no_more_than_they_say(name, tmp_path):
    verdict = referee.judge(write(tmp_path / "run", FLIGHTS[name](), every=4))
    assert verdict.conclusion == "inconclusive", [one.line() for one in verdict.differences]
    assert not verdict.agrees
    counts = verdict.counts
    assert "every 4 control steps" in verdict.sampled
    for quantity in ("outcome", "end_time_s", "path_length_m", "energy_j", "min_clearance_m"):
        assert counts[quantity].bounded == verdict.robots, quantity
    collided = name.startswith("into") or name == "arrives_and_collides"
    assert counts["impact_speed_mps"].unchecked == (verdict.robots if collided else 0)


@pytest.mark.parametrize(
    ("values", "quantity"),
    [
        ({"path_length_m": 0.88}, "path_length_m"),
        ({"min_clearance_m": 0.02}, "min_clearance_m"),
        ({"failure_time_s": 0.7}, "end_time_s"),
        ({"failure_time_s": 1.1}, "end_time_s"),
        ({"energy_j": -1.0}, "energy_j"),
        ({"energy_j": 1e5}, "energy_j"),
        ({"failure_pair": "floor"}, "failure_pair"),
        ({"failure_x_m": 0.0}, "failure_place_m"),
        ({"outcome": "out_of_bounds"}, "outcome"),
    ],
)
def test_of_sparse_samples_it_still_says_what_cannot_be(values, quantity, stored, tmp_path):
    path = stored(tmp_path, into_a_rock, every=4)
    edit_rows(path, 0, 0, **values)
    assert quantity in wrong(referee.judge(path))


def test_a_run_that_was_broken_off_is_judged_as_far_as_it_went(tmp_path):
    path = write(tmp_path / "run", to_a_goal(), worlds=2)
    config = json.loads((path / "config.json").read_text())
    (path / "config.json").write_text(json.dumps({**config, "worlds": 5}))
    verdict = referee.judge(path)
    assert (verdict.planned_worlds, verdict.finished_worlds, verdict.worlds) == (5, 2, 2)
    assert verdict.agrees
    assert referee.judge(path, [1]).worlds == 1


def _remove(*names):
    def cut(path):
        for name in names:
            place = path / name
            [file.unlink() for file in place.rglob("*") if file.is_file()]
            place.unlink(missing_ok=True) if place.is_file() else None

    return cut


def _describe(name, edit):
    def edited(path):
        place = path / "trajectories.zarr" / name / "zarr.json"
        text = place.read_text()
        place.write_text(edit(text))
        assert place.read_text() != text

    return edited


def _not_recorded(path):
    config = json.loads((path / "config.json").read_text())
    config["time"]["record_hz"] = 0.0
    (path / "config.json").write_text(json.dumps(config))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (_remove("summary.json"), "not a run folder"),
        (_not_recorded, "stored no trajectories"),
        (_remove("config.json"), "config.json"),
        (lambda path: (path / "config.json").write_text("{"), "config.json"),
        (lambda path: (path / "config.json").write_text("[1]"), "no JSON object"),
        (_remove("trajectories.zarr/p_m"), "trajectories.zarr"),
        (_describe("p_m", lambda text: text[: len(text) // 2]), "trajectories.zarr"),
        (_describe("q", lambda text: text.replace('"bytes"', '"nosuch"')), "trajectories.zarr"),
        (_describe("nu", lambda text: text.replace('"float32"', '"complex64"')), "trajectories"),
        (_remove("episodes.parquet"), "episodes.parquet"),
        (lambda path: (path / "episodes.parquet").write_bytes(b"PAR1"), "episodes.parquet"),
        (lambda path: edit_rows(path, 0, 0, robot=1), "not one row for each"),
        (lambda path: edit_array(path, "p_m", ..., lambda x: x * np.nan), "no trajectories"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_message(damage, words, stored, tmp_path):
    path = stored(tmp_path, to_a_goal)
    damage(path)
    with pytest.raises(ConfigError, match=words):
        referee.judge(path)


def test_a_world_that_is_not_there_is_named(tmp_path):
    path = write(tmp_path / "run", to_a_goal(), worlds=2)
    with pytest.raises(ConfigError, match=r"--worlds 7: .* holds worlds 0 to 1"):
        referee.judge(path, [0, 7])


def test_it_judges_by_the_copies_that_the_run_made(tmp_path):
    """A thruster that draws twice the power, under the name of the shipped vehicle."""
    path = write(tmp_path / "run", to_a_goal())
    inputs = path / "inputs"
    (inputs / "vehicles").mkdir(parents=True)
    vehicle = (vehicles.SHIPPED_FOLDER / "bluerov2_heavy.toml").read_text()
    copy = inputs / "vehicles" / "bluerov2_heavy.toml"
    copy.write_text(vehicle.replace('model = "t200"', 'model = "../double.toml"'))
    table = (vehicles.SHIPPED_FOLDER / "thrusters" / "t200.toml").read_text()
    (inputs / "double.toml").write_text(table.replace("12.8", "25.6"))
    entry = {
        "role": "vehicle",
        "named": "bluerov2_heavy",
        "copy_path": "vehicles/bluerov2_heavy.toml",
        "copy_sha256": hashlib.sha256(copy.read_bytes()).hexdigest(),
    }
    (inputs / "inputs.json").write_text(json.dumps({"files": [entry]}))
    assert wrong(referee.judge(path)) == {"energy_j"}
    edit_rows(path, 0, 0, energy_j=2 * 8 * WATTS * 29 * DT_S)
    assert referee.judge(path).agrees
    copy.write_text(copy.read_text() + "\n")
    with pytest.raises(ConfigError, match="is not the copy that the run made"):
        referee.judge(path)
