"""The simulator's account of a robot, against the referee: every way in which an episode can end.

Robots on rails meet everything in one world: rock, a ball that stands, one that comes, each other,
top and bottom, a goal, a goal and a ball at once, the horizon. Their thrusters draw power at rest,
and fleets are mixed, so that columns without a thruster must not be counted.
"""

import numpy as np
import pytest

from angler_mjx.testing import referee
from angler_mjx.testing.referee import vehicles

from .hand_made import write
from .scripted import STEPS, Ball, fly

FAR = (5.5, 5.5, -1.0)
HEAVY, SMALL = {"vehicle": "heavy.toml"}, {"vehicle": "small.toml"}
HURT = {"vehicle": "heavy.toml", "thruster_health": {"thruster_1": 0.0, "thruster_6": 0.4}}

ROBOTS = {
    "arrives and goes on": (HEAVY, (-5.0, -5.0, -2.0), (0.5, 0.0, 0.0), (-4.197, -5.0, -2.0)),
    "hits rock": (SMALL, (-5.0, -2.5, -5.0), (0.7, 0.0, 0.0), FAR),
    "arrives at a ball": (SMALL, (-5.0, 0.0, -8.0), (0.6, 0.0, 0.0), (-3.425, 0.0, -8.0)),
    "leaves at the top": (HEAVY, (4.0, -5.0, -0.6), (0.0, 0.1, 0.8), FAR),
    "leaves at the bottom": (SMALL, (4.0, -3.0, -11.5), (0.1, 0.0, -0.5), FAR),
    "meets the next": (HEAVY, (0.0, -5.0, -6.0), (0.0, 0.6, 0.0), FAR),
    "meets the last": (SMALL, (0.0, -3.0, -6.05), (0.1, -0.3, 0.0), FAR),
    "passes rock and lives": (HURT, (-5.0, 4.89, -5.2), (1.9, 0.0, 0.0), FAR),
    "meets a ball": (HEAVY, (3.0, 3.0, -8.0), (0.0, 0.4, 0.0), FAR),
    "leaves at the side": (SMALL, (5.2, 0.0, -4.0), (0.9, 0.0, 0.1), FAR),
    "stands": (HURT, (-2.0, -5.0, -10.0), (0.0, 0.0, 0.0), FAR),
    "hits what has failed": (SMALL, (0.0, -4.6, -8.0), (0.0, 0.2, 0.8), FAR),
    "passes what stands": (SMALL, (-5.0, -4.2, -10.0), (1.9, 0.0, 0.0), FAR),
}
ROCK = ((2, 2, 4), (2, 6, 4))
BALLS = (
    Ball((-3.0, 0.0, -8.0), 0.5),
    Ball((3.0, 6.0, -8.0), 0.4, (0.05, -0.7, 0.02)),
)
EXPECTED = {
    "arrives and goes on": ("reached", "none"),
    "hits rock": ("collision_static", "cell"),
    "arrives at a ball": ("collision_static", "obstacle:0"),
    "leaves at the top": ("out_of_bounds", "none"),
    "leaves at the bottom": ("out_of_bounds", "none"),
    "meets the next": ("collision_robot", "robot:6"),
    "meets the last": ("collision_robot", "robot:5"),
    "passes rock and lives": ("timeout", "none"),
    "meets a ball": ("collision_dynamic", "obstacle:1"),
    "leaves at the side": ("out_of_bounds", "none"),
    "stands": ("timeout", "none"),
    "hits what has failed": ("collision_robot", "robot:5"),
    "passes what stands": ("timeout", "none"),
}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """All of them, in vehicles whose thrusters draw 5 W more at every signal."""
    place = tmp_path_factory.mktemp("vehicles")
    table = (vehicles.SHIPPED_FOLDER / "thrusters" / "t200.toml").read_text()
    head, power = table.split("power_w = [\n")
    rows = [row.split("]")[0].strip(" [") for row in power.splitlines() if "]," in row]
    more = [[float(x) + 5.0 for x in row.split(",")] for row in rows]
    (place / "thirsty.toml").write_text(f"{head}power_w = {more}\n")
    for short, name in (("heavy", "bluerov2_heavy"), ("small", "bluerov2")):
        text = (vehicles.SHIPPED_FOLDER / f"{name}.toml").read_text()
        text = text.replace('model = "t200"', 'model = "thirsty.toml"')
        (place / f"{short}.toml").write_text(text)
    rng = np.random.default_rng(0)
    pwm = rng.uniform(1300.0, 1700.0, (STEPS, len(ROBOTS), 8)).astype(np.float32)
    for i, (entry, *_) in enumerate(ROBOTS.values()):
        if entry is SMALL:
            pwm[:, i, 6:] = 1500.0  # as the allocation leaves columns without a thruster
    return fly(tuple(ROBOTS.values()), ROCK, BALLS, pwm, place)


@pytest.fixture(scope="module")
def verdict(flight, tmp_path_factory):
    return referee.judge(write(tmp_path_factory.mktemp("run") / "run", flight))


def test_everything_happened(flight):
    found = {
        name: (row["outcome"], row["failure_pair"])
        for name, row in zip(ROBOTS, flight.rows, strict=True)
    }
    assert found == EXPECTED
    lived = flight.rows[list(ROBOTS).index("passes rock and lives")]
    assert 0.02 < lived["min_clearance_m"] < 0.3  # and it ends far from all
    passed = flight.rows[list(ROBOTS).index("passes what stands")]
    assert 0.2 < passed["min_separation_m"] < 0.5  # likewise


@pytest.mark.parametrize("quantity", [*referee.QUANTITIES])
def test_the_referee_agrees(verdict, quantity):
    said = [one.line() for one in verdict.differences if one.quantity == quantity]
    assert said == []
    count = verdict.counts[quantity]
    bounded = 1 if quantity == "impact_speed_mps" else 0  # the ball's velocity is not stored
    assert (count.exact, count.bounded) == (len(ROBOTS) - bounded, bounded)


def test_by_more_than_its_tolerances(verdict):
    largest = {name: count.largest for name, count in verdict.counts.items()}
    assert largest["path_length_m"] < 1e-4
    assert largest["energy_j"] < 1e-5
    assert largest["min_clearance_m"] < 3e-6
    assert largest["min_separation_m"] < 3e-6
    assert largest["impact_speed_mps"] < 1e-6
