"""What larger teams, denser rock and less certain vehicles do to arrivals: sweeps of shipped files.

    python -m angler_experiments.scalability.arrivals teams --out runs/teams
    python -m angler_experiments.scalability.arrivals uncertainty --out runs/uncertainty

Each sweep is what `angler sweep` makes, and goes on where it was ended when the command is given
anew. Figures, their data and tables for the page are made of the sweeps, whole or not.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from angler_mjx.report.viewing import markdown_tables, style
from angler_mjx.runs.progress import SilentProgress
from angler_mjx.runs.simulator import compile_cache
from angler_mjx.runs.storage import folder, output_lock
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies import chart, sweep
from angler_mjx.studies import tables as sweep_tables
from angler_mjx.studies.sweep_axes import parse_axes


@dataclass(frozen=True, kw_only=True)
class ArrivalsStudy:
    """One sweep."""

    name: str
    scenario: str
    """Shipped, or a file beside this one."""
    set: tuple[str, ...]
    """As for `angler sweep`."""

    def build_request(self, **options: Any) -> sweep.SweepRequest:
        """What is to be flown.

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
            set=("randomise.fault_probability=0.0,0.05,0.1,0.2", "randomise.known=false,true"),
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
"""By the word of the command line; ``smoke`` is quick, and flown to see that all of it works."""


class ArrivalsProgress(SilentProgress):
    """Says which run begins."""

    def part(self, number: int, of: int, name: str) -> None:
        """See `angler_mjx.runs.multi_run.ArrivalsProgress`."""
        print(f"  run {number + 1} of {of}: {name}", flush=True)


def run_study(study: ArrivalsStudy, out: Path, **options: Any) -> dict[str, Any]:
    """Fly what is left of a sweep; returns what it came to.

    Args:
        study: which.
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
    results: dict[str, Any], name: str, data: Path, images: Path, page: Path | None
) -> None:
    """Keep the numbers of a sweep beside its figure, and its tables in a page.

    Args:
        results: of the sweep.
        name: of the study.
        data: folder of numbers.
        images: folder of figures.
        page: with marks ``<!-- NAME: begin -->`` and ``<!-- NAME: end -->``.
    """
    data.mkdir(parents=True, exist_ok=True)
    folder.write_json(data / f"{name}.json", results)
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
    """Fly the sweeps of a study, and draw them.

    Args:
        study: Which.
        out: Folder of the sweeps; what is there already is not flown again.
        worlds: Of each cell; the scenario's if left out.
        engine: Physics engine.
        data: Folder of the figures' numbers; OUT if left out.
        images: Folder of figures; OUT if left out.
        page: Document whose tables are replaced.
        smoke: Instead of the study only what ``smoke`` flies, in seconds.
    """
    compile_cache.enable_cache()
    options: dict[str, Any] = {"engine": engine}
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
