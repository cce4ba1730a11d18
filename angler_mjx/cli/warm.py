"""`angler warm`: compile the programs of a run, and run nothing."""

from typing import Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs


def warm(
    scenario: Annotated[str, tyro.conf.Positional],
    worlds: int | None = None,
    engine: Literal["mjx", "fused"] | None = None,
    kernels: Literal["xla", "triton", "cuda"] | None = None,
    device: Device | None = None,
    devices: int | None = None,
    tile: int | None = None,
    record_hz: float | None = None,
) -> None:
    """Compile the programs of a scenario into the cache, so that `angler rollout` starts sooner.

    Give the flags of the run: each of these changes the programs. The last printed line is the
    cache folder.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        worlds: Number of worlds; the scenario's if left out. Used where the tile is left out.
        engine: Physics engine; the scenario's if left out.
        kernels: Compiler of the fused engine; if left out, triton on a GPU, else xla.
        device: Device to compute on; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all available if left out.
        tile: Worlds in one device call.
        record_hz: Rate of the stored trajectories; 0 stores none.
    """
    choose_device(device)
    keep_all_programs()
    import jax

    from angler_mjx.cli.shared.inputs import build_scenario
    from angler_mjx.runs.simulator.simulator import Simulator

    flags = {"worlds": worlds, "engine": engine, "kernels": kernels, "tile": tile}
    overrides: dict[str, object] = {key: value for key, value in flags.items() if value is not None}
    if record_hz is not None:
        overrides["time"] = {"record_hz": record_hz}
    simulator = Simulator(build_scenario(scenario, **overrides), devices=devices)
    compile_time = simulator.compile()
    for name, seconds in compile_time.by_program().items():
        print(f"{name:8} {seconds:6.1f} s")
    count = f"{simulator.tile} world{'' if simulator.tile == 1 else 's'} a tile"
    print(
        f"{compile_time.total_s:.1f} s in all: {simulator.scenario.name}, engine "
        f"{simulator.scenario.engine}, {count}, {simulator.devices} x "
        f"{jax.local_devices()[0].device_kind}"
    )
    print(jax.config.jax_compilation_cache_dir or "no folder keeps it: the cache is off")
