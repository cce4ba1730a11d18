"""Speed of real autopilots with their water: lock-step at 400 Hz, no pacing.

    python -m angler_experiments.sitl_speed --robots 1 4 8 16

For each number of robots it starts as many ArduSubs on the scenario's water, lets them boot, and
times the lock-step with the vehicles afloat, judged once a control period as in a session. The wall
time of a step is split: *waiting* is for the autopilots, the *judge* is the simulator's detection
and account, spread over the steps of a control period.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from angler_mjx.robot.vehicles import library
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_sitl.autopilots.lockstep import LockStep, LockStepTimes
from angler_sitl.firmware import binary, parameters
from angler_sitl.firmware.process import AutopilotProcess, LaunchSpec, kill_processes
from angler_sitl.scene import motion
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.wire.ports import Ports, allocate_ports

BOOT_S = 6.0
"""Simulated time until the autopilots have booted and their filters run."""


@dataclass(frozen=True, kw_only=True)
class SitlSpeed:
    """Measured speed; wall time of a step in microseconds."""

    robots: int
    real_time: float
    """Ratio of simulated to wall time."""
    physics_us: float
    replies_us: float
    waiting_us: float
    judge_us: float

    def format_row(self) -> str:
        """Format a line of the table."""
        return (
            f"{self.robots:6d} {self.real_time:9.1f}x {self.physics_us:9.1f} {self.judge_us:9.1f} "
            f"{self.replies_us:13.1f} {self.waiting_us:9.1f}"
        )


HEAD = "robots  real time   physics     judge  text+sockets   waiting   (us a step)"


def measure_speed(
    scenario: Scenario, ardusub: binary.Binary, folder: Path, sim_s: float
) -> SitlSpeed:
    """Run one fleet for some simulated seconds.

    Args:
        scenario: scenario whose fleet drifts without commands.
        ardusub: file of the autopilot.
        folder: folder of the autopilots' files.
        sim_s: measured simulated time.
    """
    scene = AutopilotScene(scenario)
    names = [f"robot_{i}" for i in range(len(scene.states.numbers))]
    vehicles = [member.variants[0].vehicle for member in scenario.members()]
    ports = allocate_ports(len(names))
    instances: list[AutopilotProcess] = []
    try:
        for i, (name, vehicle) in enumerate(zip(names, vehicles, strict=True)):
            parameter_values = parameters.for_vehicle(
                library.load_vehicle(vehicle), "guided", "vision", log=False
            )
            instances.append(
                AutopilotProcess(_launch(ardusub, folder, name, i + 1, ports[i], parameter_values))
            )
        steps = LockStep(
            [port_set.fdm for port_set in ports],
            scene,
            names=names,
            fault=lambda i: instances[i].fault(),
            condition=lambda i: instances[i].condition(),
        )
        return _time_lockstep(scene, steps, sim_s)
    finally:
        kill_processes(instances)
        for port_set in ports:
            port_set.close()


def _launch(
    ardusub: binary.Binary,
    folder: Path,
    name: str,
    sysid: int,
    ports: Ports,
    parameter_values: dict[str, float],
) -> LaunchSpec:
    return LaunchSpec(
        binary=ardusub,
        folder=folder / name,
        name=name,
        sysid=sysid,
        ports=ports,
        parameters=parameter_values,
    )


def _time_lockstep(scene: AutopilotScene, steps: LockStep, sim_s: float) -> SitlSpeed:
    steps.advance(round(BOOT_S / scene.dt_s))
    scene.moored = False
    judge_s, steps.spent = 0.0, LockStepTimes()
    periods = round(sim_s / (scene.steps_per_period * scene.dt_s))
    began = time.perf_counter()
    for _ in range(periods):
        steps.advance(scene.steps_per_period)
        before = time.perf_counter()
        scene.judge()
        judge_s += time.perf_counter() - before
    wall_s = time.perf_counter() - began
    time_spent, us_per_step = steps.spent, 1e6 / steps.spent.barriers
    return SitlSpeed(
        robots=len(scene.states.numbers),
        real_time=periods * scene.steps_per_period * scene.dt_s / wall_s,
        physics_us=us_per_step * time_spent.physics_s,
        replies_us=us_per_step * time_spent.replies_s,
        waiting_us=us_per_step * time_spent.waiting_s,
        judge_us=us_per_step * judge_s,
    )


def main(
    robots: tuple[int, ...] = (1, 4, 8, 16),
    scenario: str = "open_water_current",
    vehicle: str = "bluerov2_heavy",
    sim_s: float = 20.0,
    ardusub: Path | None = None,
) -> None:
    """Print the table.

    Args:
        robots: Sizes of the fleet.
        scenario: Scenario of the water.
        vehicle: Vehicle of the fleet.
        sim_s: Measured simulated time.
        ardusub: The autopilot; else ANGLER_ARDUSUB, else the installed one.
    """
    motion.compute_inline()
    chosen = binary.find_binary(ardusub)
    print(f"ArduSub {chosen.version}\n{HEAD}", flush=True)
    for count in robots:
        fleet = [{"vehicle": vehicle, "count": count}]
        with tempfile.TemporaryDirectory() as folder:
            loaded = load_scenario(scenario, worlds=1, fleet=fleet)
            print(measure_speed(loaded, chosen, Path(folder), sim_s).format_row(), flush=True)


if __name__ == "__main__":
    tyro.cli(main)
