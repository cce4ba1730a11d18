"""Effect of larger teams, denser rock and less certain vehicles on arrivals: sweeps.

    python -m angler_experiments.scalability.arrivals teams --out runs/teams
    python -m angler_experiments.scalability.arrivals uncertainty --out runs/uncertainty

Each sweep of a shipped file is one of `angler sweep`, and resumes when the command is repeated.
Figures, their data and tables for the page are made of the sweeps, complete or not.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from angler_mjx.progress import Progress
from angler_mjx.report.plotting import style
from angler_mjx.report.viewing import markdown_tables
from angler_mjx.runs.simulator import compile_cache
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies import chart, sweep
from angler_mjx.studies import tables as sweep_tables
from angler_mjx.studies.rows import SweepResults
from angler_mjx.studies.sweep_axes import parse_axes


@dataclass(frozen=True, kw_only=True)
class ArrivalsStudy:
    """Sweep of a study."""

    name: str
    scenario: str
    """Shipped scenario, or a file beside this module."""
    set: tuple[str, ...]
    """Values as for `angler sweep`."""

    def build_request(self, **options: str | int) -> sweep.SweepRequest:
        """Build the request of the sweep.

        Args:
            **options: keys of the scenario.
        """
        path = Path(__file__).with_name(self.scenario)
        source = str(path) if path.suffix == ".toml" else self.scenario
        loaded = load_scenario(source, time={"record_hz": 0.0}, **options)
        return sweep.build_request(loaded, parse_axes(self.set), self.scenario)


STUDIES: dict[str, tuple[ArrivalsStudy, ...]] = {
    "teams": (
        ArrivalsStudy(
            name="teams",
            scenario="dense_dynamic",
            set=(
                "fleet.0.count=1,4,16",
                "world.density=0.03,0.1,0.2",
                "planner.name=grid,priority",
                "world.placement=random",
                "world.obstacles.dynamic.count=12",
            ),
        ),
    ),
    "uncertainty": (
        ArrivalsStudy(
            name="estimate", scenario="reef_fleet", set=("fleet.*.estimate=truth,noisy,ekf",)
        ),
        ArrivalsStudy(
            name="noise",
            scenario="reef_fleet",
            set=("randomise.sensor_noise=[1,1],[2,2],[4,4],[8,8]", "fleet.*.estimate=ekf"),
        ),
        ArrivalsStudy(
            name="faults",
            scenario="reef_fleet",
            set=("randomise.fault_probability=0.0,0.05,0.1,0.2", "randomise.visible=false,true"),
        ),
        ArrivalsStudy(
            name="mix",
            scenario="reef_fleet",
            set=(
                "fleet.0.parameter_mix={wu2018=1.0},{blue_gazebo=1.0},{von_benzon2022=1.0},"
                "{wu2018=1.0,von_benzon2022=1.0,blue_gazebo=1.0}",
            ),
        ),
    ),
    "smoke": (
        ArrivalsStudy(
            name="smoke",
            scenario="smoke.toml",
            set=("world.currents.0.max_speed_mps=1.5,0.5",),
        ),
    ),
}
"""Studies by the word of the command line; ``smoke`` is quick, for a test of all of it."""


class ArrivalsProgress(Progress):
    """Progress that prints its lines, such as the run that begins."""

    def report(self, text: str) -> None:
        """See `Progress`."""
        print(f"  {text}", flush=True)


def run_study(study: ArrivalsStudy, out: Path, **options: str | int) -> SweepResults:
    """Fly the remaining cells of a sweep; return its results.

    Args:
        study: study to run.
        out: folder of its sweep.
        **options: keys of the scenario.
    """
    if (out / sweep.SWEEP).is_file() and sweep.read_sweep(out)["complete"]:
        return sweep.read_sweep(out)
    is_resumed = output_lock.partial_path(out).is_dir() or out.is_dir()
    return sweep.run_sweep(
        study.build_request(**options), out, progress=ArrivalsProgress(), resume=is_resumed
    )


def store_results(
    results: SweepResults, name: str, data: Path, images: Path, page: Path | None
) -> None:
    """Write the numbers of a sweep beside its figure, and its tables into a page.

    Args:
        results: results of the sweep.
        name: name of the study.
        data: folder of numbers.
        images: folder of figures.
        page: with marks ``<!-- NAME: begin -->`` and ``<!-- NAME: end -->``.
    """
    data.mkdir(parents=True, exist_ok=True)
    write_json(data / f"{name}.json", dict(results))
    figure = style.save_figure(
        chart.plot_sweep(results), images / f"scalability_{name}.png", palette=128
    )
    if page is not None:
        parts = [sweep_tables.cells_table(results), sweep_tables.pairs_table(results)]
        text = "\n\n".join(
            [
                markdown_tables.image_link(page, figure),
                *("\n".join(sweep_tables.format_grid(grid_table)) for grid_table in parts),
            ]
        )
        markdown_tables.replace_section(
            page, f"<!-- {name}: begin -->", text, f"<!-- {name}: end -->"
        )


def main(
    study: Annotated[Literal["teams", "uncertainty", "smoke"], tyro.conf.Positional],
    out: Path = Path("runs/scalability"),
    worlds: int | None = None,
    engine: Literal["fused", "mjx"] = "fused",
    data: Path | None = None,
    images: Path | None = None,
    page: Path | None = None,
    smoke: bool = False,
) -> None:
    """Fly the sweeps of a study, and plot them.

    Args:
        study: Name of the study.
        out: Folder of the sweeps; finished cells are not flown again.
        worlds: Worlds of each cell; the scenario's if left out.
        engine: Physics engine.
        data: Folder of the figures' numbers; OUT if left out.
        images: Folder of figures; OUT if left out.
        page: Document whose tables are replaced.
        smoke: Fly only the study ``smoke``, in seconds.
    """
    compile_cache.enable_cache()
    options: dict[str, str | int] = {"engine": engine}
    if worlds is not None:
        options["worlds"] = worlds
    for sweep_study in STUDIES["smoke" if smoke else study]:
        print(f"{sweep_study.name}: {' '.join(sweep_study.set)}", flush=True)
        results = run_study(sweep_study, out / sweep_study.name, **options)
        store_results(results, sweep_study.name, data or out, images or out, page)
        print(json.dumps({"study": sweep_study.name, "complete": results["complete"]}), flush=True)
        if not results["complete"]:
            sys.exit(130)


if __name__ == "__main__":
    tyro.cli(main)
