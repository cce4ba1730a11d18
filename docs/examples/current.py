"""Change the water of a scenario: the same worlds in still water, and in a stream with eddies.

Tables of a scenario are merged into its file; a list, as that of the currents, replaces the file's.
"""

import jax.numpy as jnp

import angler_mjx as angler

WATER = {
    "still": [],
    "eddies": [
        {"type": "uniform", "velocity_mps": [-0.2, 0.0, 0.0]},
        {"type": "vortices", "count": 4, "peak_speed_mps": [0.2, 0.4], "core_radius_m": [2.0, 4.0]},
    ],
}


def main(seconds: float = 10.0) -> dict[str, float]:
    """Return the mean electrical power [W] of the robots in each water."""
    power_w = {}
    for name, currents in WATER.items():
        scenario = angler.load_scenario(
            "open_water_current",
            worlds=4,
            tile=4,
            world={"currents": currents},
            time={"horizon_s": seconds},
        )
        simulator = angler.Simulator(scenario)
        worlds = simulator.worlds(seed=3)
        state = simulator.reset(worlds)
        for _ in range(simulator.segments):
            state, _ = simulator.segment(worlds, state)
        power_w[name] = float(jnp.mean(state.tally.energy_j) / seconds)
        print(f"{name}: {power_w[name]:.0f} W")
    return power_w


if __name__ == "__main__":
    main()
