"""Autopilots brought up together, and what is said when one does not come up: with stand-ins."""

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from angler_mjx.errors import RunError
from angler_sitl.autopilots import boot as booting
from angler_sitl.autopilots.boot import WorldOrigin, boot_autopilots
from angler_sitl.autopilots.lockstep import LockStep
from angler_sitl.firmware.process import AutopilotProcess, LaunchSpec, kill_processes
from angler_sitl.steering.autopilot_commander import (
    NavigationFix,
    SimulatedCommander,
    collect_motion,
    mode_name,
)
from angler_sitl.wire.ports import allocate_ports

HOME = WorldOrigin(lat_deg=47.6, lon_deg=-122.3)
STEP_S, PERIOD = 1 / 100, 5
"""Coarser than a real one's, for speed: a stand-in has no controllers that would mind."""


class Still:
    """A scene in which nothing moves: vehicle i is i metres north and 3 m deep, level."""

    def __init__(self, count):
        self.time_s = 0.0
        self._numbers = np.zeros((count, 16))
        self._numbers[:, 5] = -9.80665
        self._numbers[:, 6] = np.arange(count)
        self._numbers[:, 8] = 3.0
        self._numbers[:, 9] = 1.0

    def step(self, _):
        self.time_s += STEP_S
        return SimpleNamespace(numbers=self._numbers)


@contextmanager
def started(program, folder, *each):
    """Pilots of stand-ins with their parameters, and a function that goes on by a period."""
    bound, instances = allocate_ports(len(each)), []
    try:
        for i, (ports, parameters) in enumerate(zip(bound, each, strict=True)):
            launch = LaunchSpec(
                binary=program,
                folder=folder / str(i),
                name=f"robot_{i}",
                sysid=i + 1,
                ports=ports,
                parameters=parameters,
            )
            instances.append(AutopilotProcess(launch))
        pilots = [SimulatedCommander(f"robot_{i}", i + 1, ports) for i, ports in enumerate(bound)]
        scene = Still(len(each))
        lockstep = LockStep(
            [ports.fdm for ports in bound],
            scene,
            names=[pilot.name for pilot in pilots],
            fault=lambda i: instances[i].fault(),
        )

        def advance():
            lockstep.advance(PERIOD)
            for i, pilot in enumerate(pilots):
                pilot.tick(scene.time_s)
                place, spread = np.array([i, 0.0, 3.0]), np.full(3, 0.01)
                pilot.send_fix(
                    scene.time_s,
                    NavigationFix(
                        p=place,
                        q=np.array([1.0, 0, 0, 0]),
                        velocity_mps=np.zeros(3),
                        position_std_m=spread,
                        velocity_std_mps=spread,
                        attitude_std_rad=spread,
                    ),
                )
            return scene.time_s

        yield pilots, advance
    finally:
        kill_processes(instances)
        for ports in bound:
            ports.close()


def test_they_come_up_together(stand_in, tmp_path):
    with started(stand_in, tmp_path, {"SIM_RATE_HZ": 400.0}, {}) as (pilots, advance):
        ready = boot_autopilots(pilots, advance, mode=4, source="vision", home=HOME)
        assert all(pilot.armed and pilot.has_position for pilot in pilots)
        assert {mode_name(pilot.mode) for pilot in pilots} == {"GUIDED"}
        assert pilots[0].link.parameters["SIM_RATE_HZ"] == 400.0
        # All of them, and by number: some could have been lost on the way.
        assert pilots[0].link.parameter_count == len(pilots[0].link.parameter_indices)
        now = advance()
        motion = collect_motion(pilots, now)
    # 1 m north is y = 1 m, 3 m down is z = -3 m; float32 on the wire.
    np.testing.assert_allclose(motion.p, [[0.0, 0.0, -3.0], [0.0, 1.0, -3.0]], atol=1e-6)
    # Level and heading north: a quarter turn left of east.
    np.testing.assert_allclose(np.abs(motion.q), [[0.5**0.5, 0, 0, 0.5**0.5]] * 2, atol=1e-6)
    np.testing.assert_allclose(motion.nu, np.zeros((2, 6)), atol=1e-6)
    # Far from the time limits, by the scene's clock.
    assert 2.0 < ready.sim_s < 12.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"STANDIN_NO_EKF": 1.0}, r"robot_1: its EKF finds no position within 5 s .*EKF bad"),
        ({"STANDIN_NO_ARM": 1.0}, r"robot_1: refuses to arm within 3 s .*disarmed.*ArduSub says: "),
        ({"STANDIN_EXIT_S": 2.5}, r"robot_1: .* ended with exit code 3"),
    ],
)
def test_the_one_that_does_not_come_up_is_named(stand_in, tmp_path, monkeypatch, wrong, said):
    monkeypatch.setitem(booting.POSITION_TIMEOUT_S, "vision", 5.0)
    monkeypatch.setattr(booting, "ARM_TIMEOUT_S", 3.0)
    with (
        started(stand_in, tmp_path, {}, wrong) as (pilots, advance),
        pytest.raises(RunError, match=said),
    ):
        boot_autopilots(pilots, advance, mode=4, source="vision", home=HOME)


def test_who_never_spoke_is_named(ports):
    clock = iter(np.arange(0.0, 100.0, 0.05))
    pilot = SimulatedCommander("robot_7", 8, ports)
    with pytest.raises(RunError, match="robot_7: says nothing on MAVLink within 15 s"):
        boot_autopilots([pilot], lambda: float(next(clock)), mode=4, source="vision", home=HOME)
    with pytest.raises(RunError, match=r"robot_7.*not told its motion"):
        collect_motion([pilot], 0.0)
