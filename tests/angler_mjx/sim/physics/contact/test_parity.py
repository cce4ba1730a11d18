"""Contact against MuJoCo C on the same contacts, and against non-negative least squares."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.mjx_contact import Touches
from angler_mjx.sim.physics.contact.resolve import ContactSpec, WorldBodies, resolve_contact

from ....compiling import thoroughly
from .by_mujoco import Reference, Settings, solve_dual

LAYOUT = BodyLayout(robots=0, joints=0, capsules=0, obstacles=3, has_capsules=True, has_boxes=True)
SHAPES = {1: 0, 2: 1, 3: 5, 0: LAYOUT.shapes + 1}
"""Shape by geom of MuJoCo: capsules of obstacles, then boxes; its plane is the floor."""
UPRIGHT = [1.0, 0.0, 0.0, 0.0]
LYING = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
SMOOTH = {
    "rest": ([0.1, 0.08, 0.1], {}, {}, Settings()),
    "pushed at rest": ([0.1, 0.08, 0.1], {}, {12: 8.0, 13: 2.0, 1: 1.0}, Settings()),
    "rolling": ([0.1, 0.08, 0.1], {0: 0.3, 1: 0.1, 4: 3.0, 6: 0.4}, {}, Settings()),
    "sliding": ([0.1, 0.08, 0.1], {13: 1.0, 12: 0.4, 7: 0.8}, {13: 30.0}, Settings(friction=0.1)),
    "pushing another": ([0.1, 0.08, 0.1], {}, {0: 25.0, 2: 2.0}, Settings(friction=0.2)),
}
"""Heights of sphere, capsule and box, velocities and forces by number, coefficients."""


@pytest.fixture(scope="module")
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def resolve(x64):
    """A function (reference, problem, settings) -> accelerations and normal forces."""

    def solved(bodies, touches, friction, zeta, rate, dt):
        spec = ContactSpec(
            friction=jnp.full((4, 4), friction),
            damping_ratio=jnp.full((4, 4), zeta),
            rate_radps=rate,
        )
        forces = resolve_contact(spec, LAYOUT, WorldBodies(**bodies), touches, dt)
        return (forces.velocity - bodies["velocity"]) / dt, forces.normal_force_n

    compiled = thoroughly(solved)

    def run(reference, problem, settings):
        data = reference.data
        k = LAYOUT.points
        assert data.ncon <= k
        touches = Touches(
            depth_m=np.full(k, -1.0),
            position=np.zeros((k, 3)),
            normal=np.tile([0.0, 0.0, 1.0], (k, 1)),
            first=np.full(k, LAYOUT.shapes + 1, np.int32),
            second=np.zeros(k, np.int32),
        )
        for i, contact in enumerate(data.contact):
            touches.depth_m[i] = -contact.dist
            touches.position[i], touches.normal[i] = contact.pos, contact.frame[:3]
            touches.first[i], touches.second[i] = (SHAPES[g] for g in contact.geom)
        v = data.qvel.copy()
        bodies = dict(
            p=data.xpos[1:].copy(),
            rotation=data.xmat[1:].reshape(3, 3, 3).copy(),
            free=np.ones(3, bool),
            velocity=v,
            unconstrained=v + settings.dt * problem.a0,
            M_robots=np.zeros((0, 6, 6)),
            M_obstacles=np.stack([problem.M[i : i + 6, i : i + 6] for i in (0, 6, 12)]),
        )
        numbers = settings.friction, settings.zeta, settings.rate, settings.dt
        acceleration, normal = jax.device_get(compiled(bodies, touches, *numbers))
        return acceleration, normal[: data.ncon]

    return run


def start(heights, velocities):
    """Return positions and velocities of a scene whose bodies stand in a row, almost touching."""
    qpos = np.concatenate(
        [
            [-0.25 - 1e-3, 0.01, heights[0] - 1e-6, *UPRIGHT],
            [0.6, 0.0, heights[1] - 1e-6, *LYING],
            [0.0, 0.0, heights[2] - 1e-6, *UPRIGHT],
        ]
    )
    qvel = np.zeros(18)
    for number, value in velocities.items():
        qvel[number] = value
    return qpos, qvel


@pytest.mark.parametrize("name", SMOOTH)
def test_a_second_of_contact_equals_mujoco_c(name, resolve, deviation):
    heights, velocities, forces, settings = SMOOTH[name]
    theirs = start(heights, velocities)
    ours = start(heights, velocities)
    push = np.zeros(18)
    for number, value in forces.items():
        push[number] = value
    reference = Reference()
    met, gap = 0, []
    for _ in range(200):
        reference.place(*theirs)
        acceleration, _ = reference.solve(reference.problem(settings, push))
        velocity = theirs[1] + settings.dt * acceleration
        theirs = reference.advance(theirs[0], velocity, settings.dt), velocity
        reference.place(*ours)
        met += reference.data.ncon > 0
        acceleration, _ = resolve(reference, reference.problem(settings, push), settings)
        velocity = ours[1] + settings.dt * acceleration
        ours = reference.advance(ours[0], velocity, settings.dt), velocity
        gap.append(np.abs(ours[0] - theirs[0]).max())
    assert met > 150
    deviation("contact.parity", gap, 1e-9, about=name)


def test_accelerations_solve_the_stated_problem(resolve, deviation):
    rng = np.random.default_rng(0)
    reference, contacts = Reference(), 0
    for _ in range(40):
        qpos, qvel = start([0.1, 0.08, 0.1], {})
        qpos[[0, 1, 7, 8, 14, 15]] += rng.normal(0.0, 0.08, 6)
        qpos[[2, 9, 16]] += rng.uniform(-0.02, 0.005, 3)
        qpos[17:21] += rng.normal(0.0, 0.05, 4)
        qpos[17:21] /= np.linalg.norm(qpos[17:21])
        qvel += rng.normal(0.0, 0.5, 18)
        settings = Settings(
            friction=rng.uniform(0.05, 1.0), zeta=rng.uniform(0.1, 2.0), rate=rng.uniform(20, 60)
        )
        reference.place(qpos, qvel)
        problem = reference.problem(settings, rng.normal(0.0, 5.0, 18))
        ours, normal = resolve(reference, problem, settings)
        dual, force = solve_dual(problem)
        of_c, _ = reference.solve(problem)
        np.testing.assert_allclose(of_c, dual, rtol=1e-8, atol=1e-8)
        deviation.close("contact.acceleration", ours, dual, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(normal, force.reshape(-1, 4).sum(axis=1), rtol=1e-5, atol=1e-4)
        contacts += reference.data.ncon
    assert contacts > 150
