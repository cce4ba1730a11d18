"""Which ways a vehicle can be driven: by hand-made wrench matrices and by files."""

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles import drive, library
from angler_mjx.robot.vehicles.params import build_vehicle

from . import made_up

D_L, D_Q = np.array([1.0, 2.0, 3.0]), np.array([10.0, 20.0, 30.0])


def able(thrusters, forward_n=40.0, reverse_n=-30.0):
    """Of thrusters about the centre of mass: place and direction."""
    position = np.array([x[0] for x in thrusters], float)
    direction = np.array([x[1] for x in thrusters], float)
    wrench = np.concatenate([direction, np.cross(position, direction)], axis=1).T
    return drive.compute_drive(wrench, reverse_n, forward_n, D_L, D_Q)


X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
PAIR = [((0, 0.2, 0), X), ((0, -0.2, 0), X)]

CASES = {
    "pair and lift": ([*PAIR, ((0, 0, 0.1), Z)], ("sway",)),
    "pair, lift and side": ([*PAIR, ((0, 0, 0.1), Z), ((0, 0, 0), Y)], ()),
    "side at the stern alone turns": ([((0, 0, 0), X), ((-0.3, 0, 0), Y), ((0, 0, 0), Z)],
                                      ("sway", "yaw")),
    "side at bow and stern": ([((0, 0, 0), X), ((-0.3, 0, 0), Y), ((0.3, 0, 0), Y),
                               ((0, 0, 0), Z)], ()),
    "no lift": (PAIR, ("sway", "heave")),
    "lift only": ([((0, 0.1, 0), Z), ((0, -0.1, 0), Z)], ("surge", "sway", "yaw")),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_ways_that_are_missing(case):
    thrusters, missing = CASES[case]
    assert able(thrusters).missing_axes == missing


def test_speeds_balance_damping_in_the_slower_direction():
    speed = able(CASES["pair, lift and side"][0]).terminal_speed_mps
    force = np.array([60.0, 30.0, 30.0])  # reverse is the weaker
    np.testing.assert_allclose(D_L * speed + D_Q * speed**2, force, rtol=1e-12)


def test_thrusters_without_reverse_drive_no_way():
    assert able(CASES["pair and lift"][0], reverse_n=0.0).missing_axes == ("surge", "sway", "heave")


def test_a_sway_of_canted_thrusters_is_not_counted():
    """Thrusters that lean to the side by a degree: at their sway's speed nothing would move."""
    lean = np.deg2rad(1.0)
    canted = [((0.2 * x, 0.2 * y, 0), (np.cos(lean), x * y * np.sin(lean), 0))
              for x in (1, -1) for y in (1, -1)]  # fmt: skip
    assert able([*canted, ((0, 0, 0), Z)]).missing_axes == ("sway",)


@pytest.mark.parametrize("name", library.list_rovs())
def test_shipped_vehicles_go_every_way(name):
    config = library.load_vehicle(name)
    for chosen in config.parameter_sets:
        assert np.all(np.asarray(build_vehicle(config, chosen, 16.0).terminal_speed_mps) > 0.3)


def test_a_vehicle_that_cannot_fly_is_named(tmp_path):
    config = library.load_vehicle(
        str(made_up.write(tmp_path / "t.toml", made_up.TORPEDO, name="tube"))
    )
    lame = able(CASES["no lift"][0])
    with pytest.raises(ConfigError, match=r"vehicle 'tube' cannot fly a path: no thrust in heave"):
        drive.require_flyable(config, lame)
    drive.require_flyable(config, able(CASES["pair and lift"][0]))


def test_two_files_of_one_size_and_age_are_two_files(tmp_path):
    path = made_up.write(tmp_path / "t.toml", made_up.FOUR, name="one")
    assert library.load_vehicle(str(path)).name == "one"
    path.write_text(path.read_text().replace('"one"', '"two"'))
    assert library.load_vehicle(str(path)).name == "two"
