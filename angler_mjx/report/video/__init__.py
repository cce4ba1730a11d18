"""Pictures and videos of recorded worlds, rendered by MuJoCo without a display.

`recording` writes the files. A world becomes a MuJoCo model (`scene_model`) and arrays of poses at
the times of the frames (`frames`); `renderer` is the program that renders them, in processes of its
own, which `render_pool` starts; `overlay` and `encoder` make the file.
"""

from angler_mjx.report.video.recording import write_picture, write_video

__all__ = ["write_picture", "write_video"]
