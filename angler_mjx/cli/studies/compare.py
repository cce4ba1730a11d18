"""`angler compare`: two runs of the same worlds, paired."""

import json as text
from pathlib import Path
from typing import Annotated

import tyro


def compare(
    first: Annotated[Path, tyro.conf.Positional],
    second: Annotated[Path, tyro.conf.Positional],
    figure: Path | None = None,
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Print the differences between two runs of the same worlds, and their effects, world by world.

    Args:
        first: Run folder, called A.
        second: Run folder of the same seed, worlds and robots, called B. Changes are B minus A.
        figure: File to plot the changes into, such as compare.png.
        json: Print one JSON object, with all worlds that changed, instead of the text.
    """
    from angler_mjx.report.plotting import style
    from angler_mjx.runs.storage.folder import Run
    from angler_mjx.studies import compare as comparing
    from angler_mjx.studies import comparison_report

    if figure is not None:
        style.require_format(figure, flag="--figure")
    comparison = comparing.compare_runs(Run(first), Run(second))
    print(text.dumps(comparison) if json else comparison_report.format_comparison(comparison))
    if figure is not None:
        style.save_figure(comparison_report.plot_comparison(comparison), figure)
