"""Figures of a run, plotted from its folder alone into ``figures/``."""

from collections.abc import Sequence
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.report.plotting import scene, style
from angler_mjx.report.viewing import statistics, task_figure
from angler_mjx.report.viewing.maps import world_map
from angler_mjx.report.viewing.world_selection import good_world, worst_world
from angler_mjx.runs.storage.folder import FIGURES, Run


def plot_figures(run: Run, worlds: Sequence[int] | None = None) -> list[Path]:
    """Plot all figures of a run; older ones of the same name are replaced.

    ``outcomes.png``, ``distances.png`` and ``time_to_goal.png`` about all robots, and one
    ``map_world_K.png`` for each chosen world, where the run stored trajectories; of a task also
    ``task_world_K.png``.

    Args:
        run: run folder.
        worlds: global indices to map; the worst and one good world if left out.

    Returns:
        The files, in the order above.

    Raises:
        ConfigError: the run does not hold a world.
        RunError: a file cannot be written.
    """
    folder = run.path / FIGURES
    name, episodes = run.scenario.name, run.episodes
    selected = _select_worlds(run, worlds) if run.scenario.time.record_hz > 0 else {}
    paths = [
        style.save_figure(statistics.plot_outcomes(episodes, name), folder / "outcomes.png"),
        style.save_figure(statistics.plot_distances(episodes, name), folder / "distances.png"),
        style.save_figure(
            statistics.plot_times(episodes, name, run.scenario.time.horizon_s),
            folder / "time_to_goal.png",
        ),
    ]
    paths += [save_world_map(run, world, label) for world, label in selected.items()]
    if run.scenario.task_spec() is not None:
        paths += [save_task_map(run, world) for world in selected]
    return paths


def save_task_map(run: Run, world: int) -> Path:
    """Plot a team's task in one world.

    Args:
        run: run folder of a scenario with a task, with trajectories.
        world: global index.
    """
    figure = task_figure.plot_task(run, scene.read_scene(run, world))
    return style.save_figure(figure, run.path / FIGURES / f"task_world_{world}.png")


def save_world_map(run: Run, world: int, label: str = "") -> Path:
    """Plot the map of one world.

    Args:
        run: run folder, with trajectories.
        world: global index.
        label: reason of the selection, for the title.
    """
    world_scene = scene.read_scene(run, world)
    density = float(world_scene.environment.density)
    rock = f"{100 * density:.1f} % of the cells are rock" if density > 0 else "no rock"
    figure = world_map.plot_world(
        world_scene,
        title=f"World {world}{label}: {world_map.describe_outcomes(world_scene)}",
        subtitle=f"{run.scenario.name}, seed {run.scenario.seed}; {rock}",
    )
    return style.save_figure(figure, run.path / FIGURES / f"map_world_{world}.png")


def _select_worlds(run: Run, worlds: Sequence[int] | None) -> dict[int, str]:
    """Return the worlds to map, with their labels."""
    if worlds is not None:
        indices = set(run.episodes["world"].to_pylist())
        for world in worlds:
            if world not in indices:
                raise ConfigError(f"world {world} is not in {run.path}")
        return dict.fromkeys(worlds, "")
    worst, good = worst_world(run), good_world(run)
    if worst == good:  # a run of one world, or of worlds with equal results
        return {worst: ""}
    return {worst: " (the worst)", good: " (a good one)"}
