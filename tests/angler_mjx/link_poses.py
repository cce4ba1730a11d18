"""Poses of links by MuJoCo, for comparison."""

import mujoco
import numpy as np

from angler_mjx.robot.vehicles.mjcf import to_spec


def locate_by_mujoco(config, p, q, position):
    """Return origins [L, 3] and rotations [L, 3, 3] of links in W, by name.

    Args:
        config: vehicle file.
        p: [3] m of the base's centre of mass in W.
        q: [4] F to W.
        position: [J] joints in the simulator's order.
    """
    model = to_spec(config, None, shapes=False).compile()
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[3:7] = p, q
    for joint, value in zip(config.find_joints(), position, strict=True):
        data.joint(f"joint/{joint.name}").qpos[:] = value
    mujoco.mj_kinematics(model, data)
    bodies = {link.name: data.body(f"link/{link.name}") for link in config.find_links(None)}
    return {name: (body.xpos.copy(), body.xmat.reshape(3, 3)) for name, body in bodies.items()}


def world_rotation(q):
    """Return the rotation [3, 3] of a quaternion [4] wxyz."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(q, float))
    return matrix.reshape(3, 3)
