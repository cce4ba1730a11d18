"""Fly a vehicle of your own: a changed file of a shipped one, beside the shipped one.

A vehicle is a TOML file (docs/generated/vehicle.md); `angler vehicle show FILE` prints what it says
about mass, thrust and terminal speeds.
"""

from pathlib import Path

import angler_mjx as angler
from angler_mjx.robot.vehicles import library


def write_vehicle(path: Path) -> None:
    """Write a BlueROV2 Heavy with a battery box below it: heavier, and its weight lower."""
    text = library.locate_vehicle("bluerov2_heavy").read_text(encoding="utf-8")
    text = text.replace('name = "bluerov2_heavy"', 'name = "heavier"', 1)
    path.write_text(text.replace("mass_kg = 13.5", "mass_kg = 15.5"), encoding="utf-8")


def main(folder: Path = Path(".")) -> dict[str, float]:
    """Return the mean energy [J] that a robot of each vehicle has used after a minute."""
    file = folder / "heavier.toml"
    write_vehicle(file)
    energy_j = {}
    for vehicle in ("bluerov2_heavy", str(file)):
        fleet = [
            {"vehicle": vehicle, "count": 2, "parameter_set": name}
            for name in ("blue_gazebo", "von_benzon2022")
        ]
        scenario = angler.load_scenario(
            "open_water_current", worlds=8, fleet=fleet, time={"horizon_s": 60.0}
        )
        simulator = angler.Simulator(scenario)
        worlds = simulator.worlds(seed=3)
        state = simulator.reset(worlds)
        for _ in range(simulator.segments):
            state, _ = simulator.segment(worlds, state)
        name = Path(vehicle).stem
        energy_j[name] = float(state.tally.energy_j.mean())
        print(f"{name}: {energy_j[name] / 1000:.1f} kJ")
    return energy_j


if __name__ == "__main__":
    main()
