"""`angler dataset`: make, show and judge datasets."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from angler_mjx.cli.shared.device import Device, choose, keep_all_programs

if TYPE_CHECKING:
    from angler_mjx.datasets.manifest import Manifest


def make(
    config: Annotated[Path, tyro.conf.Positional],
    episodes: int,
    out: Path | None = None,
    resume: bool = False,
    device: Device | None = None,
    devices: int | None = None,
    workers: int | None = None,
) -> None:
    """Fly the episodes of a dataset file, and write them with all that is to be known of them.

    Args:
        config: Dataset file (.toml).
        episodes: How many, of all scenes, teams and experts together.
        out: Folder to make; datasets/NAME if left out.
        resume: Go on with an interrupted one of the same file and number.
        device: Where to compute; JAX's choice if left out.
        devices: Number of devices to spread the worlds over; all there are if left out. Changes no
            byte of the results.
        workers: Processes that plan, where a planner is one of the host; one for each processor if
            left out. Changes no byte of the results.
    """
    choose(device, distributed=False)
    keep_all_programs()
    from angler_mjx.cli.shared.given import at_least_one
    from angler_mjx.cli.shared.progress import DatasetBar
    from angler_mjx.datasets import making, manifest

    asked = making.ask(config, episodes)
    place = out or Path("datasets") / asked.config.name
    with DatasetBar() as bar:
        made = making.make(
            asked,
            place,
            told=bar,
            resume=resume,
            devices=devices,
            workers=at_least_one("workers", workers),
        )
    if made is None:
        print(f"interrupted; go on with --resume --out {place}", file=sys.stderr)
        sys.exit(130)
    _report(made, manifest.read(made))


def show(dataset: Annotated[Path, tyro.conf.Positional]) -> None:
    """Say what is in a dataset.

    Args:
        dataset: Its folder.
    """
    from angler_mjx.datasets import manifest

    _report(dataset, manifest.read(dataset))


def _report(place: Path, found: "Manifest") -> None:
    from rich.console import Console
    from rich.table import Table

    shown = Table(title=f"{found.name}: {found.episodes:,} episodes")
    for heading in ("part", "expert", "robots", "worlds", "split"):
        shown.add_column(heading, justify="right" if heading in ("robots", "worlds") else "left")
    for part in found.parts:
        split = part.split or "by environment"
        shown.add_row(part.path, part.expert, str(part.robots), f"{part.worlds:,}", split)
    console = Console()
    console.print(shown)
    console.print(", ".join(f"{name}: {count:,}" for name, count in found.splits.items()))
    console.print(str(place), highlight=False, soft_wrap=True)
