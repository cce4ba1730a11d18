"""Messages of a scene without a loop: covariances of the estimate."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from angler_mjx.serve.messages import SceneMessages
from angler_mjx.serve.scene_view import SceneView, list_facts


def build_odometry(session, scene, covariance, turn):
    """Return the message of the estimate of robot 1, which has this attitude and covariance."""
    session.reset()
    seen = session.observe()
    q = np.array(seen.estimate.q)
    q[1] = turn.as_quat(scalar_first=True)
    view = SceneView(
        observation=replace(seen, covariance=covariance, estimate=replace(seen.estimate, q=q)),
        current_mps=None,
        energy_j=np.zeros(2),
        wall_ns=0,
    )
    messages = SceneMessages(
        session.robots,
        list_facts(scene),
        dt_s=session.dt_s,
        density_kgpm3=1000.0,
        gravity_mps2=9.81,
        has_instruments=False,
    )
    builders = dict(messages.build_step(view, [{}, {}]))
    return builders["/robot_1/local_position/odom"]()


def test_the_covariance_of_the_velocity_is_turned_into_the_robots_frame(session, scene):
    turn = Rotation.from_euler("ZYX", [2.0, 0.4, -0.3])
    root = np.random.default_rng(0).normal(size=(2, 9, 9))
    covariance = root @ np.swapaxes(root, 1, 2)
    message = build_odometry(session, scene, covariance, turn)
    pose = np.reshape(message["pose"]["covariance"], (6, 6))
    np.testing.assert_array_equal(pose, covariance[1, :6, :6])
    twist = np.reshape(message["twist"]["covariance"], (6, 6))
    to_robot = turn.as_matrix().T
    want = to_robot @ covariance[1, 6:, 6:] @ to_robot.T
    np.testing.assert_allclose(twist[:3, :3], want, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(twist[3:], 0.0)
    np.testing.assert_array_equal(twist[:, 3:], 0.0)


def test_an_estimate_that_is_the_truth_has_no_covariance(session, scene):
    message = build_odometry(session, scene, None, Rotation.identity())
    for part in ("pose", "twist"):
        assert not np.any(message[part].get("covariance", 0.0))
