"""Window of the Rerun viewer on one recording, with its initial layout."""

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from typing import IO, TYPE_CHECKING

import numpy as np

from angler_mjx.errors import UnsupportedError

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_VIEWER = (sys.executable, "-m", "rerun_cli")

_START_S, _SETTLE_S = 30.0, 1.0
"""Time limit of the viewer's start, and time that it must keep running once it listens.

It ends within a second of listening where there is no screen or no graphics."""


def has_display() -> bool:
    """Return whether there is a display for the viewer."""
    displays = (os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return sys.platform != "linux" or any(displays)


def open_viewer(
    recording: "rr.RecordingStream", blueprint: "rrb.Blueprint", viewer: Sequence[str] = _VIEWER
) -> None:
    """Open the viewer on a recording; it stays open when this process ends.

    It has a window of its own, and not a tab of an open viewer: that viewer would keep the layout
    of its earlier recording. Its own messages are not shown, since a terminal may be in use. It
    listens to this machine alone.

    Args:
        recording: data logged to it from now on are shown.
        blueprint: layout of the viewer.
        viewer: its command.

    Raises:
        UnsupportedError: it cannot be started.
    """
    port = _free_port()
    arguments = ["--port", str(port), "--bind", "127.0.0.1", "--expect-data-soon"]
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            [*viewer, *arguments, "--memory-limit", "75%"],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,  # Ctrl-C in the terminal must not reach the viewer
        )
        if not _is_listening(process, port):
            output.seek(0)
            raise UnsupportedError(f"the Rerun viewer cannot be started: {_read_reason(output)}")
    recording.connect_grpc(f"rerun+http://127.0.0.1:{port}/proxy")
    activate_blueprint(recording, blueprint)


def activate_blueprint(recording: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
    """Activate a blueprint for a recording.

    A mere default would lose against the blueprint of the last recording, which the viewer keeps on
    disk, and which shows nothing where the world has another index.
    """
    recording.send_blueprint(blueprint, make_active=True, make_default=True)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def _is_listening(viewer: subprocess.Popen[bytes], port: int) -> bool:
    """Wait until the viewer listens and keeps running; return whether it does."""
    last = time.monotonic() + _START_S
    while time.monotonic() < last and viewer.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except OSError:
            time.sleep(0.05)
            continue
        try:
            viewer.wait(_SETTLE_S)
        except subprocess.TimeoutExpired:
            return True
    return False


def _read_reason(output: IO[bytes]) -> str:
    """Return the last line of the viewer's output."""
    lines = output.read().decode(errors="replace").split("\n")
    return next((line for line in reversed(lines) if line), "it does not answer")


def build_blueprint(content: "rrb.Container | rrb.View", panel: "rrb.TimePanel") -> "rrb.Blueprint":
    """Build a window with only views and the time panel.

    Args:
        content: the views.
        panel: settings of the timeline.
    """
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        content,
        panel,
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )


def space_view(
    contents: Sequence[str],
    root: str,
    name: str,
    eye: "rrb.EyeControls3D",
    growing_paths: Sequence[str] = (),
) -> "rrb.Spatial3DView":
    """Build a view of a world.

    Args:
        contents: paths of the shown entities.
        root: path of the world's entities, with the leading slash.
        name: of the view.
        eye: viewpoint.
        growing_paths: paths of entities that are shown with all their data logged so far.
    """
    import rerun.blueprint as rrb

    time_range = rrb.VisibleTimeRanges(
        timeline="time",
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Spatial3DView(
        origin=root,
        contents=contents,
        name=name,
        background=[16, 38, 54],
        line_grid=False,
        eye_controls=eye,
        overrides={path: time_range for path in growing_paths},
    )


def eye_above(bounds_m: tuple[np.ndarray, np.ndarray]) -> "rrb.EyeControls3D":
    """Return an eye that sees the whole world from above one of its corners.

    Args:
        bounds_m: lower and upper corner [3] of the world.
    """
    import rerun.blueprint as rrb

    low, high = bounds_m
    middle, size = 0.5 * (low + high), float(max(high - low))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=middle + size * np.array([0.95, -1.35, 0.75]),
        look_target=middle - size * np.array([0.0, 0.0, 0.08]),
        eye_up=[0.0, 0.0, 1.0],
    )
