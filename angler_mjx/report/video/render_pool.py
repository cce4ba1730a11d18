"""Processes that render frames, and the choice of an OpenGL that works without a display."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

import mujoco
import numpy as np

from angler_mjx.errors import RunError, UnsupportedError
from angler_mjx.report.video.frames import Frames, empty_frames

_RENDERER = (sys.executable, str(Path(__file__).with_name("renderer.py")))

_EMPTY = "<mujoco><worldbody/></mujoco>"

_REMEDY = (
    "install Mesa's software renderer (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri, or "
    "libosmesa6), or name another OpenGL of MuJoCo with MUJOCO_GL"
)


def list_backends() -> Sequence[str | None]:
    """Return the values of MUJOCO_GL to try; None leaves the choice to MuJoCo."""
    if chosen := os.environ.get("MUJOCO_GL"):
        return [chosen]
    return ["egl", "osmesa"] if sys.platform == "linux" else [None]


def render(
    model: mujoco.MjModel,
    frames: Frames,
    size_px: tuple[int, int],
    *,
    processes: int,
    line_px: int = 3,
    renderer: Sequence[str] = _RENDERER,
) -> Iterator[np.ndarray]:
    """Render all frames in order.

    Args:
        model: of the world.
        frames: N of them.
        size_px: width and height of the pictures.
        processes: number of processes; frames are dealt out one by one.
        line_px: width of lines, pixels.
        renderer: command of the renderer.

    Yields:
        uint8 [height, width, 3], N times.

    Raises:
        UnsupportedError: no OpenGL works here.
        RunError: a renderer ended before its last frame.
    """
    count = len(frames.qpos)
    reasons = []
    with tempfile.TemporaryDirectory(prefix="angler_video_") as name:
        folder = Path(name)
        mujoco.mj_saveModel(model, str(folder / "model.mjb"))
        frames.save(folder / "frames.npz")
        for backend in list_backends():
            command = [*renderer, str(folder), *map(str, size_px), str(line_px)]
            with _start_renderers(command, min(processes, count), backend) as started:
                picture = _read_picture(started[0], size_px)
                if picture is None:
                    reasons.append(f"{backend or 'default'}: {_read_reason(started[0])}")
                    continue
                yield picture
                for i in range(1, count):
                    process = started[i % len(started)]
                    picture = _read_picture(process, size_px)
                    if picture is None:
                        reason = _read_reason(process)
                        raise RunError(f"the renderer ended at frame {i} of {count}: {reason}")
                    yield picture
                return
    raise UnsupportedError(
        f"no picture was rendered, OpenGL does not work here ({'; '.join(reasons)}); {_REMEDY}"
    )


def require_opengl() -> None:
    """Refuse to render where no OpenGL works; a renderer is started to find out.

    Raises:
        UnsupportedError: no OpenGL works here.
    """
    model = mujoco.MjModel.from_xml_string(_EMPTY)
    list(render(model, empty_frames(), (64, 64), processes=1))


class _Renderer:
    """A process that renders, and the file that holds its messages."""

    def __init__(self, command: Sequence[str], backend: str | None, messages: IO[bytes]) -> None:
        """Start it; see `_start_renderers`."""
        chosen = {} if backend is None else {"MUJOCO_GL": backend}
        paths = os.pathsep.join(path for path in sys.path if path)
        self.messages = messages
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=messages,
            env={**os.environ, **chosen, "PYTHONPATH": paths},
        )

    def stop(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()


@contextmanager
def _start_renderers(
    command: Sequence[str], processes: int, backend: str | None
) -> Iterator[list[_Renderer]]:
    """Start renderers of every `processes`-th frame; they end with the context."""
    with ExitStack() as stack:
        started = []
        for first in range(processes):
            messages = stack.enter_context(tempfile.TemporaryFile())
            arguments = [*command, str(first), str(processes)]
            renderer = _Renderer(arguments, backend, messages)
            stack.callback(renderer.stop)
            started.append(renderer)
        yield started


def _read_picture(renderer: _Renderer, size_px: tuple[int, int]) -> np.ndarray | None:
    """Return the next picture of a renderer; None if it ended."""
    width, height = size_px
    stream = renderer.process.stdout
    data = b"" if stream is None else stream.read(3 * width * height)
    if len(data) < 3 * width * height:
        return None
    return np.frombuffer(data, np.uint8).reshape(height, width, 3)


def _read_reason(renderer: _Renderer) -> str:
    """Return the last line that an ended renderer printed, or the signal that ended it."""
    code = renderer.process.wait()
    renderer.messages.seek(0)
    text = renderer.messages.read().decode(errors="replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    ended = f"ended by signal {-code}" if code < 0 else f"exit status {code}"
    return lines[-1] if lines and code > 0 else ended
