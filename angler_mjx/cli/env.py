"""`angler env`: generate environments into a file, and render one of them."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from angler_mjx.errors import ConfigError, format_value


def make_environments(
    out: Path,
    preset: str = "reef",
    count: int = 100,
    seed: int = 0,
    density: float | None = None,
    robots: int = 4,
    radius_m: float = 0.4,
    placement: Literal["cross", "parallel", "random"] | None = None,
    tile: Annotated[int, tyro.conf.arg(help_behavior_hint="(default: 256)")] = 256,
) -> None:
    """Generate environments and write them to a Zarr file.

    Args:
        out: File to make, for example envs.zarr.
        preset: Kind of world: angler2024, sparse, reef, dense, corridor, open, angler_nine_boxes.
        count: Number of worlds.
        seed: Seed of the worlds; world i of a seed does not depend on the count.
        density: Fraction of occupied cells; the preset's if left out.
        robots: Number of robots with a start and a goal.
        radius_m: Radius of the robots' bounding sphere, m.
        placement: Placement of starts and goals; the preset's if left out.
        tile: Number of worlds generated at once.
    """
    for name, number, maximum in (
        ("count", count, 10**9),
        ("robots", robots, 1024),
        ("tile", tile, 10**7),
    ):
        if not 1 <= number <= maximum:
            raise ConfigError(
                f"--{name} {format_value(number)}: must be at least 1 and at most {maximum}"
            )
    if not 0 <= seed < 2**32:
        raise ConfigError(f"--seed {format_value(seed)}: must be 0 to {2**32 - 1}")
    if not 0 < radius_m <= 1000:
        raise ConfigError(f"--radius-m {radius_m:g}: must be above 0 and at most 1000")
    import numpy as np
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from angler_mjx.files import parse_model
    from angler_mjx.runs.storage import environments as store
    from angler_mjx.world.config import WorldConfig

    options = {"preset": preset, "density": density, "placement": placement}
    data = {key: value for key, value in options.items() if value is not None}
    config = parse_model(WorldConfig, data, source="flags of angler env make")
    columns = ("worlds", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("worlds", total=count)
        radii = np.full(robots, radius_m)
        invalid = store.generate_file(
            out, config, radii, seed, count, tile, lambda done: bar.update(task, completed=done)
        )
    if invalid:
        print(f"{invalid} of {count} worlds cannot hold the fleet; they are marked valid = False")
    print(out)


def show_environment(
    file: Annotated[Path, tyro.conf.Positional], index: int = 0, *, out: Path
) -> None:
    """Render one environment of a file.

    Args:
        file: File of `angler env make`, or a run folder with stored trajectories.
        index: Index of the world.
        out: Image to write, for example env.png.
    """
    from angler_mjx.report.plotting import style
    from angler_mjx.report.viewing import environment_figure
    from angler_mjx.runs.storage import environments as store
    from angler_mjx.runs.stored_arrays import stored_array

    style.require_format(out)
    group = store.open_environments(file)
    count = stored_array(group, "valid").shape[0]
    if not 0 <= index < count:
        raise ConfigError(f"--index {index}: {file} holds worlds 0 to {count - 1}")
    config = group.attrs.get("world_config")  # environments of a run have none
    name = str(config.get("preset", file.name)) if isinstance(config, dict) else file.name
    figure = environment_figure.plot_environment(
        store.read_environments(group, index), title=f"{name}, world {index}"
    )
    style.save_figure(figure, out)
    print(out)
