"""Recording of a drive as a run folder, for replays, figures and exports as of any other run.

Beside the files of every run lies ``keys.txt``, the pressed keys: as a script they repeat the same
drive of the same scene.
"""

from typing import Any

from angler_mjx.errors import RunError
from angler_mjx.runs.session.recording import RecordedCourse, SessionRecording
from angler_mjx.runs.storage.folder import Run
from angler_mjx.teleop import script
from angler_mjx.teleop.loop import DriveResult

KEYS_FILE = "keys.txt"
"""Name of the file of keys in a run folder."""


class TeleopRecording(SessionRecording):
    """Run folder in progress; see `SessionRecording`."""

    def finish(self, driven: DriveResult, compile_s: float) -> Run | None:
        """Write the run.

        Args:
            driven: result of the drive.
            compile_s: seconds of compilation.

        Returns:
            The run; None if not even one step was driven.

        Raises:
            RunError: writing to the disk failed.
        """
        if not driven.steps:
            return None
        try:
            script.save_keys(self.building / KEYS_FILE, driven.keys)
        except OSError as error:
            raise RunError(
                f"{self.building / KEYS_FILE}: cannot be written ({error.strerror or error})"
            ) from error
        return self.close(
            RecordedCourse(
                steps=driven.steps,
                wall_s=driven.wall_s,
                compile_s=compile_s,
                more={"teleop": _build_summary(driven)},
                interrupted=driven.broken,
            )
        )


def _build_summary(driven: DriveResult) -> dict[str, Any]:
    overruns = driven.overruns
    return {
        "steps": driven.steps,
        "scene_s": driven.scene_s,
        "realtime": overruns is not None,
        "overruns": None if overruns is None else overruns.count,
        "worst_overrun_s": None if overruns is None else overruns.worst_s,
        "keys": len(driven.keys),
    }
