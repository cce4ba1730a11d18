"""Bounces, sliding and rest of one body over a floor in vacuum, against closed forms."""

import jax
import numpy as np
import pytest

from angler_mjx.world.materials import restitution_of_damping

from .over_floor import RECORDS, begin, box, fly, sphere

G = 9.81
MASS = [2.0, 2.0, 2.0, 0.02, 0.02, 0.02]
SLAB = [2.0, 2.0, 2.0, 0.03, 0.03, 0.05]
HALF = [0.2, 0.2, 0.05]
SOFTNESS = 5e-4
"""Of a row of contact; see `resolve.SOFTNESS`."""


@pytest.fixture(autouse=True)
def x64():
    with jax.enable_x64(True):
        yield


def rebounds(cases, *, dt, steps, velocity=(0.0, 0.0, -0.5, 0.0, 0.0, 0.0)):
    """Return normal speeds after over before of spheres that hit the floor without weight."""
    bodies = [sphere(0.1, pull=[0.0, 0.0, 0.0], dt=dt, **case) for case in cases]
    motions = [begin([0.0, 0.0, 0.1 + 1e-9], velocity)] * len(bodies)
    return fly(bodies, motions, steps).velocity[:, -1, 2] / -velocity[2]


def test_restitution_is_that_of_the_damping_ratio_to_first_order_in_the_step(deviation):
    ratios = np.array([0.1, 0.2, 0.5, 1.0, 2.0])
    cases = [{"mass": MASS, "zeta": z} for z in ratios]
    want = restitution_of_damping(ratios)
    errors = []
    for i, dt in enumerate((5e-3, 2.5e-3, 1.25e-3, 6.25e-4)):
        errors.append(rebounds(cases, dt=dt, steps=8 * 2**i) - want)
    order = np.log2(np.abs(errors[-2]) / np.abs(errors[-1]))
    assert np.all(order > 0.7), order
    deviation("contact.restitution", np.abs(errors[0]), 0.05)
    assert np.abs(errors[-1]).max() < 0.006


def test_restitution_depends_neither_on_mass_nor_on_added_mass():
    heavy, light = [20.0] * 3 + [2.0] * 3, [0.05] * 3 + [1e-4] * 3
    added = [3.0, 2.5, 9.0, 0.03, 0.04, 0.02]
    cases = [{"mass": mass, "zeta": 0.3} for mass in (MASS, heavy, light, added)]
    found = rebounds(cases, dt=2e-3, steps=20)
    np.testing.assert_allclose(found, found[0], rtol=1e-7)


SLIDES = [(mu, angle) for mu in (0.1, 0.3, 0.6) for angle in (0.0, 0.4, 0.25 * np.pi, 2.0)]


def test_a_sliding_block_stops_after_the_distance_of_coulomb_in_every_direction(deviation):
    speed = 1.0
    bodies, motions = [], []
    for mu, angle in SLIDES:
        velocity = [speed * np.cos(angle), speed * np.sin(angle), 0.0, 0.0, 0.0, 0.0]
        bodies.append(box(HALF, SLAB, pull=[0.0, 0.0, -2.0 * G], friction=mu))
        motions.append(begin([0.0, 0.0, HALF[2]], velocity))
    motion = fly(bodies, motions, 10)
    end = motion.p[:, -1]
    distance = np.hypot(end[:, 0], end[:, 1])
    want = np.array([speed**2 / (2.0 * mu * G) for mu, _ in SLIDES])
    deviation.close("contact.sliding", distance, want, rtol=0.04)
    angles = np.arctan2(end[:, 1], end[:, 0])
    np.testing.assert_allclose(angles, [angle for _, angle in SLIDES], atol=0.01)
    by_friction = distance.reshape(3, 4)
    assert np.all(np.ptp(by_friction, axis=1) < 0.015 * by_friction[:, 0])
    # Friction of a convex contact lifts a sliding body a little, and more where it is faster.
    assert np.all(motion.p[:, :, 2] - HALF[2] < 2.5e-3)


def test_a_block_rests_on_a_gentle_slope_and_slides_down_a_steep_one(deviation):
    bodies, motions, slides = [], [], []
    for mu in (0.2, 0.4, 0.8):
        for steepness in (0.5, 0.8, 1.3, 2.0):
            slope = np.arctan(steepness * mu)
            pull = 2.0 * G * np.array([np.sin(slope) * 0.6, np.sin(slope) * 0.8, -np.cos(slope)])
            bodies.append(box(HALF, SLAB, pull=pull, friction=mu))
            motions.append(begin([0.0, 0.0, HALF[2]]))
            slides.append(max(0.0, G * (np.sin(slope) - mu * np.cos(slope))))
    slides = np.array(slides)
    motion = fly(bodies, motions, 5)
    seconds = RECORDS * 5 * 0.005
    end = motion.p[:, -1]
    distance = np.hypot(end[:, 0], end[:, 1])
    still = slides == 0.0
    assert np.all(distance[still] < 2.5e-3)  # creep, and slip while it settles
    want = 0.5 * slides * seconds**2
    deviation.close("contact.sliding", distance[~still], want[~still], rtol=0.04)


def test_a_body_comes_to_rest_after_a_fall_whatever_its_restitution(deviation):
    bodies, motions = [], []
    for g in (G, 0.3):
        for zeta in (0.1, 0.2, 0.5):
            for make, size, mass in ((box, HALF, SLAB), (sphere, 0.1, MASS)):
                pull = [0.1 * g * (make is box), 0.0, -2.0 * g]
                bodies.append(make(size, mass, pull=pull, friction=0.6, zeta=zeta))
                motions.append(begin([0.0, 0.0, (HALF[2] if make is box else 0.1) + 0.02]))
    motion = fly(bodies, motions, 50)
    deviation("contact.rest", np.abs(motion.velocity[:, -20:, 2]), 1e-6)
    weights = np.array([-body.pull[2] for body in bodies])
    np.testing.assert_allclose(motion.normal_n[:, -1], weights, rtol=1e-5)
    rises = motion.p[:, :, 2] - motion.p[:, -1:, 2]
    assert np.all(rises[:, 0] != 0.0)


def test_a_box_at_rest_neither_sinks_nor_turns_and_creeps_as_derived(deviation):
    """Creep under a push F that friction holds: 4 SOFTNESS dt F / (m mu^2), at one point."""
    dt, seconds = 0.005, 60.0
    bodies, motions, pushes = [], [], []
    for g in (G, 0.3):
        for mu in (0.31, 0.6):
            for fraction in (0.0, 0.2):
                weight = 2.0 * g
                side = fraction * mu * weight
                pull = [0.8 * side, 0.6 * side, -weight]
                bodies.append(box(HALF, SLAB, pull=pull, friction=mu, dt=dt))
                motions.append(begin([0.0, 0.0, HALF[2] - 1e-7]))
                pushes.append(0.0)
    for mu in (0.31, 0.6):  # spheres that do not turn
        side = 0.2 * mu * 2.0 * G
        unturned = MASS[:3] + [1e9] * 3
        bodies.append(sphere(0.1, unturned, pull=[side, 0.0, -2.0 * G], friction=mu, dt=dt))
        motions.append(begin([0.0, 0.0, 0.1 - 1e-7]))
        pushes.append(4.0 * SOFTNESS * dt * side / (MASS[0] * mu**2))
    motion = fly(bodies, motions, round(seconds / dt / RECORDS))
    settled = 10
    late = motion.p[:, settled:]
    creep = np.hypot(*np.moveaxis(late[:, -1, :2] - late[:, 0, :2], -1, 0))
    creep /= seconds * (RECORDS - 1 - settled) / RECORDS
    sinking = late[:, 0, 2] - late[:, -1, 2]
    assert np.all(creep[[0, 2, 4, 6]] * 3600.0 < 1e-6)
    assert np.all(np.abs(sinking) * 60.0 < 1e-6)
    deviation("contact.creep", creep[[5, 7]] * 3600.0, 0.012)
    np.testing.assert_allclose(creep[8:], pushes[8:], rtol=0.01)
    assert np.all(np.abs(motion.R[:, -1] - np.eye(3)) < 1e-5)
    assert np.all(motion.most_depth_m[:, -1] < 1e-4)
    weights = np.array([-body.pull[2] for body in bodies])
    np.testing.assert_allclose(motion.normal_n[:, -1], weights, rtol=1e-6)
