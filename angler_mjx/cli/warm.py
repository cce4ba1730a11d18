"""`angler warm`: compile the programs of runs, and run nothing."""

from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import Device, Kernels, choose_device, keep_all_programs

if TYPE_CHECKING:
    from angler_mjx.scenario.scenario import Scenario


def warm(
    scenarios: Annotated[tuple[str, ...], tyro.conf.Positional] = (),
    worlds: int | None = None,
    engine: Literal["mjx", "fused"] | None = None,
    kernels: Kernels | None = None,
    device: Device | None = None,
    devices: int | None = None,
    tile: int | None = None,
    record_hz: float | None = None,
) -> None:
    """Compile the programs of scenarios into the cache, so that `angler rollout` starts sooner.

    Give the flags of the run: each of these changes the programs. The last printed line is the
    cache folder.

    Args:
        scenarios: Names of shipped scenarios, or paths of scenario files (.toml); all shipped ones
            if left out.
        worlds: Number of worlds; the scenario's if left out. Used where the tile is left out.
        engine: Physics engine; the scenario's if left out.
        kernels: Compiler of the fused engine; if left out, cuda on a GPU, else xla. triton
            means cuda, until 1.0.
        device: Device to compute on; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all available if left out.
        tile: Worlds in one device call.
        record_hz: Rate of the stored trajectories; 0 stores none.
    """
    choose_device(device)
    keep_all_programs()
    import jax

    from angler_mjx.cli.shared.inputs import build_scenario
    from angler_mjx.scenario.scenario import shipped_scenarios

    flags = {"worlds": worlds, "engine": engine, "kernels": kernels, "tile": tile}
    overrides: dict[str, object] = {key: value for key, value in flags.items() if value is not None}
    if record_hz is not None:
        overrides["time"] = {"record_hz": record_hz}
    for name in scenarios or sorted(shipped_scenarios()):
        print(_compile(build_scenario(name, **overrides), devices), flush=True)
    print(jax.config.jax_compilation_cache_dir or "no folder keeps it: the cache is off")


def _compile(scenario: "Scenario", devices: int | None) -> str:
    """Compile the programs of a scenario; return a line with the seconds of each."""
    import jax

    from angler_mjx.runs.simulator.simulator import Simulator

    simulator = Simulator(scenario, devices=devices)
    try:
        compile_time = simulator.compile()
    finally:
        simulator.close()
    seconds = ", ".join(f"{name} {s:.1f}" for name, s in compile_time.by_program().items())
    count = f"{simulator.tile} world{'' if simulator.tile == 1 else 's'} a tile"
    return (
        f"{scenario.name}: {compile_time.total_s:.1f} s ({seconds}); engine {scenario.engine}, "
        f"{count}, {simulator.devices} x {jax.local_devices()[0].device_kind}"
    )
