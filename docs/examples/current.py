"""Change the water of a scenario: the same worlds in a slow and in a fast stream with eddies.

Tables of a scenario are merged into its file; a list, as that of the currents, replaces the file's.
"""

import jax.numpy as jnp

import angler_mjx as angler


def build_currents(speed_mps: float) -> list[dict[str, object]]:
    """Return a steady stream against the fleet, a slow wander on top, and wide eddies."""
    peak = [speed_mps, 2 * speed_mps]
    return [
        {"type": "uniform", "velocity_mps": [-speed_mps, 0.0, 0.0]},
        {"type": "gauss_markov", "max_speed_mps": speed_mps, "time_constant_s": 90.0},
        {"type": "vortices", "count": 4, "peak_speed_mps": peak, "core_radius_m": [2.0, 4.0]},
    ]


def main(seconds: float = 60.0) -> dict[str, float]:
    """Return the mean electrical power [W] of the robots in each water."""
    power_w = {}
    for name, speed_mps in (("slow", 0.02), ("fast", 0.2)):
        scenario = angler.load_scenario(
            "open_water_current",
            worlds=8,
            world={"currents": build_currents(speed_mps)},
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
