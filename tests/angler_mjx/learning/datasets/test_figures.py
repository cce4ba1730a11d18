"""Figures of the card: numbers in words, and marks where robots were."""

import numpy as np
import pytest

from angler_mjx.learning.datasets import figures, index, manifest
from angler_mjx.runs.storage.folder import Run


@pytest.mark.parametrize(
    ("ended", "rate"),
    [({"timeout": 2}, "0 %"), ({"reached": 3, "timeout": 1}, "75 %"), ({"reached": 2}, "100 %")],
)
def test_the_headline_says_how_many_robots_arrived(made, ended, rate):
    figure = figures.plot_counts(manifest.read_manifest(made), index.read_index(made), ended)
    texts = [text.get_text() for text in figure.texts]
    assert f"small: 6 episodes, {rate} of robots arrived" in texts


def test_a_cross_marks_where_each_robot_failed(made):
    found = manifest.read_manifest(made)
    figure = figures.plot_flights(made, found, index.read_index(made))
    marks = [
        {tuple(line.get_xydata()[0]) for line in panel.lines if line.get_marker() == "X"}
        for panel in figure.axes
        if panel.get_title(loc="left")
    ]
    wanted = []
    for part in found.parts:
        rows = Run(made / part.path).episodes.to_pylist()
        for world in range(part.worlds):
            failed = [row for row in rows if row["world"] == world and row["outcome"] != "reached"]
            wanted.append({(row["failure_x_m"], row["failure_y_m"]) for row in failed})
    assert any(wanted)
    assert len(marks) == len(wanted)
    for plotted, expected in zip(marks, wanted, strict=True):
        np.testing.assert_allclose(sorted(plotted), sorted(expected), atol=1e-6)
