"""A window of the Rerun viewer on one recording, and what it shows at first."""

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
"""A viewer that does not listen in that time has failed; so has one that ends within a second of
listening, as it does where there is no screen or no graphics."""


def has_display() -> bool:
    """Whether there is a display to open the viewer on."""
    displays = (os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return sys.platform != "linux" or any(displays)


def open_viewer(
    recording: "rr.RecordingStream", blueprint: "rrb.Blueprint", viewer: Sequence[str] = _VIEWER
) -> None:
    """Open the viewer on a recording; it stays when this process ends.

    It has a window of its own, and not a tab of a viewer that is open already: that one would go on
    with the layout of what it showed before. What it says of its own doings is not shown, since a
    terminal may be in use. It listens to this machine alone.

    Args:
        recording: what is logged to it from now on is shown.
        blueprint: what is shown, and how.
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
            start_new_session=True,  # Ctrl-C in the terminal is not for it
        )
        if not _is_listening(process, port):
            output.seek(0)
            raise UnsupportedError(f"the Rerun viewer cannot be started: {_read_reason(output)}")
    recording.connect_grpc(f"rerun+http://127.0.0.1:{port}/proxy")
    activate_blueprint(recording, blueprint)


def activate_blueprint(recording: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
    """Have a recording shown by a blueprint.

    A mere default would lose against the blueprint of the last recording, which the viewer has kept
    on disk, and which shows nothing where the world has another index.
    """
    recording.send_blueprint(blueprint, make_active=True, make_default=True)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def _is_listening(viewer: subprocess.Popen[bytes], port: int) -> bool:
    """Wait until the viewer listens, and see that it stays."""
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
    """The last line that the viewer wrote."""
    lines = output.read().decode(errors="replace").split("\n")
    return next((line for line in reversed(lines) if line), "it does not answer")


def build_blueprint(content: "rrb.Container | rrb.View", panel: "rrb.TimePanel") -> "rrb.Blueprint":
    """A window with nothing but views and the time panel.

    Args:
        content: the views.
        panel: how time runs.
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
    """A view of a world.

    Args:
        contents: paths of what it shows.
        root: path of the world's entities, with the leading slash.
        name: of the view.
        eye: from where.
        growing_paths: paths of entities that are shown with all that was logged of them until now.
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
    """An eye that sees all of a world from above one of its corners.

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
