"""The training curve: losses of a training by step, in a file and as a picture."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from angler_mjx.report.plotting import style
from angler_mjx.runs.storage.atomic_files import write_text

FILE = "losses.csv"


class LossRow(NamedTuple):
    """Losses after a call of the training program."""

    step: int
    loss: float
    """Mean of the steps of the call."""
    validation_loss: float
    """Of the averaged parameters on worlds that are held back; nan without such worlds."""


def read_losses(file: Path) -> list[LossRow]:
    """Return the rows of a training by step; none without a file.

    Args:
        file: ``losses.csv`` in the folder of a training.
    """
    if not file.exists():
        return []
    with file.open(newline="", encoding="utf-8") as lines:
        return [
            LossRow(int(row["step"]), float(row["loss"]), float(row["validation_loss"]))
            for row in csv.DictReader(lines)
        ]


def write_losses(rows: Sequence[LossRow], file: Path) -> None:
    """Write rows by step, whole or not at all."""
    lines = [f"{row.step},{row.loss:.6g},{row.validation_loss:.6g}" for row in rows]
    write_text(file, "\n".join([",".join(LossRow._fields), *lines]) + "\n")


def plot_losses(rows: Sequence[LossRow], file: Path) -> Path:
    """Plot losses against steps.

    Args:
        rows: by step.
        file: picture to write.
    """
    steps, loss, validation_loss = np.array(rows).T
    with style.figure_style():
        figure = style.new_figure(5.6, 3.4)
        axes = figure.add_subplot()
        axes.plot(steps, loss, color=style.robot_color(0), label="mean of the steps")
        axes.plot(steps, validation_loss, "--", color=style.INK, label="worlds held back")
        axes.set_xlabel("step")
        axes.set_ylabel("loss")
        axes.grid(visible=True)
        axes.legend()
        return style.save_figure(figure, file, palette=128)
