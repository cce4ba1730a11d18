"""Whether an OpenGL renders without a display here; tests that need one are skipped otherwise."""

from contextlib import closing
from functools import cache

import mujoco

from angler_mjx.errors import UnsupportedError
from angler_mjx.report.video import frames, render_pool

BALL = "<mujoco><worldbody><geom type='sphere' size='1'/></worldbody></mujoco>"


@cache
def reason_without():
    """Return why nothing can be rendered, or None."""
    model, still = mujoco.MjModel.from_xml_string(BALL), frames.empty_frames()
    try:
        with closing(render_pool.render(model, still, (64, 64), processes=1)) as pictures:
            assert next(pictures).any()
    except UnsupportedError as error:
        return str(error)
    return None
