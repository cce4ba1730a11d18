"""Text on pictures: time, outcomes, and the current at the robots."""

from collections.abc import Sequence
from math import ceil

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from angler_mjx.report.plotting.scene import ReplayScene

_TEXT_FRACTION, _MARGIN_FRACTION = 0.03, 0.02
"""Height of the text and margin, of the picture's height."""
_EVENT_S = 6.0
"""Time that an outcome stays in sight, s."""
_STILL_MPS = 0.005
"""Speed below which no current is shown."""
_LINE_FACTOR, _OUTLINE_PX = 1.35, 2
"""Height of a line, of the text's size, and width of the outline of letters."""
_MAX_RENDERED_LINES = 32
_INK, _SHADE = (245, 250, 252), (10, 30, 42)


class Overlay:
    """Text of a world at its times."""

    def __init__(self, scene: ReplayScene, title: str, height_px: int) -> None:
        """Prepare the text.

        Args:
            scene: the world.
            title: line at the bottom.
            height_px: height of the pictures.
        """
        self._scene, self._title = scene, title
        self._margin_px = round(_MARGIN_FRACTION * height_px)
        size = max(round(_TEXT_FRACTION * height_px), 10)
        # matplotlib ships it, so that text looks the same everywhere.
        self._font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size)
        speeds = [np.linalg.norm(robot.current_mps, axis=1) for robot in scene.robots]
        self._current_mps = np.stack(speeds, axis=1)
        self._line_px = round(_LINE_FACTOR * size)
        self._rendered: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def write_on(self, picture: np.ndarray, time_s: float) -> np.ndarray:
        """Return a picture [height, width, 3] with the text of a time."""
        written = picture.copy()
        for number, line in enumerate(self.describe(time_s)):
            self._write(written, line, self._margin_px + number * self._line_px)
        self._write(written, self._title, len(picture) - self._margin_px - self._line_px)
        return written

    def describe(self, time_s: float) -> Sequence[str]:
        """Return the lines about a time: time, current, arrivals, and latest outcomes."""
        scene = self._scene
        sample = min(int(np.searchsorted(scene.time_s, time_s)), len(scene.time_s) - 1)
        ended = [robot for robot in scene.robots if robot.end_time_s <= time_s + 1e-6]
        lines = [f"{time_s:.1f} s", self._describe_current(sample, time_s)]
        if scene.task is not None:
            lines.append(scene.task.describe_progress(min(sample, len(scene.task.time_s) - 1)))
        else:
            arrived = sum(robot.arrived for robot in ended)
            lines.append(f"{arrived} of {len(scene.robots)} robots arrived")
        fresh = [robot for robot in ended if time_s - robot.end_time_s < _EVENT_S]
        lines += [f"robot {robot.index} {scene.ended(robot)}" for robot in fresh[:4]]
        return [line for line in lines if line]

    def _describe_current(self, sample: int, time_s: float) -> str:
        flying = [robot.end_time_s > time_s for robot in self._scene.robots]
        speeds = self._current_mps[sample, flying]
        speeds = speeds[np.isfinite(speeds)]
        speed = float(np.mean(speeds)) if speeds.size else 0.0
        return f"current {speed:.2f} m/s" if speed >= _STILL_MPS else ""

    def _write(self, picture: np.ndarray, text: str, top_px: int) -> None:
        """Write a line into a picture, at its left."""
        ink, outline = self._render_line(text)
        rows = slice(top_px, top_px + ink.shape[0])
        columns = slice(self._margin_px, self._margin_px + ink.shape[1])
        part = picture[rows, columns]
        ink, outline = (mask[: part.shape[0], : part.shape[1]] for mask in (ink, outline))
        mixed = part + outline * (np.array(_SHADE, np.float32) - part)
        picture[rows, columns] = np.rint(mixed + ink * (np.array(_INK, np.float32) - mixed))

    def _render_line(self, text: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the opacity [height, width, 1] of a line's letters and of their outlines."""
        if text not in self._rendered:
            size = (ceil(self._font.getlength(text)) + 2 * _OUTLINE_PX, self._line_px)
            masks = []
            for width_px in (0, _OUTLINE_PX):
                image = Image.new("L", size)
                position = (_OUTLINE_PX, _OUTLINE_PX)
                canvas = ImageDraw.Draw(image)
                canvas.text(position, text, fill=255, font=self._font, stroke_width=width_px)
                masks.append(np.asarray(image, np.float32)[..., None] / 255.0)
            # The clock's line is of one frame only; the others return.
            while len(self._rendered) >= _MAX_RENDERED_LINES:
                self._rendered.pop(next(iter(self._rendered)))
            self._rendered[text] = (masks[0], masks[1])
        return self._rendered[text]
