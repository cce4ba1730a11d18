"""Collisions keep momentum; piles gain no energy; random scenes stay finite."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.sim.physics.contact.candidates import Rock
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE
from angler_mjx.world.rock.grid import Grid

from ....compiling import thoroughly
from .loose_bodies import DT, advance, describe, lay_out

SCENES = 256
G = 1.0
"""m/s2: a body of little weight in water."""
HEIGHT = 0.7
"""m, of the rock that lies on the floor."""


def angular_momentum(p, q, v, mass, inertia):
    w, u = q[:, :1], q[:, 1:]
    spin = v[:, 3:]
    turned = spin + 2.0 * np.cross(u, np.cross(u, spin) + w * spin)
    return np.sum(mass[:, None] * np.cross(p, v[:, :3]) + inertia[:, None] * turned, axis=0)


def test_bodies_that_collide_keep_linear_and_angular_momentum(deviation):
    rng = np.random.default_rng(1)
    layout = lay_out(2, boxes=False)
    with jax.enable_x64(True):

        def fly(bodies, *start):
            begin = (*start, jnp.zeros(()))
            step = lambda _, now: advance(layout, bodies, jnp.zeros(3), None, now)  # noqa: E731
            return jax.lax.fori_loop(0, 100, step, begin)

        compiled = thoroughly(jax.vmap(fly))
        n = 16
        mass, inertia = rng.uniform(0.5, 4.0, (n, 2)), rng.uniform(0.01, 0.1, (n, 2))
        kind = np.tile([CAPSULE, SPHERE], (n, 1))
        size = np.tile([[0.1, 0.25, 0.0], [0.15, 0.0, 0.0]], (n, 1, 1))
        bodies = jax.tree.map(
            lambda *rows: np.stack(rows),
            *[describe(*rows) for rows in zip(kind, size, mass, inertia, strict=True)],
        )
        p = np.tile([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]], (n, 1, 1)) + rng.uniform(
            -0.1, 0.1, (n, 2, 3)
        )
        q = rng.normal(size=(n, 2, 4))
        q /= np.linalg.norm(q, axis=2, keepdims=True)
        v = rng.normal(0.0, 0.3, (n, 2, 6))
        v[:, 0, 0], v[:, 1, 0] = 1.0, -1.0
        p_end, q_end, v_end, depth = jax.device_get(compiled(bodies, p, q, v))
    hit = depth > 1e-4
    assert hit.sum() >= 12
    changed = np.abs(v_end - v).max(axis=(1, 2))
    assert np.all(changed[hit] > 0.05)
    linear = np.einsum("nb,nbi->ni", mass, v_end[:, :, :3] - v[:, :, :3])
    turning = [
        angular_momentum(p_end[i], q_end[i], v_end[i], mass[i], inertia[i])
        - angular_momentum(p[i], q[i], v[i], mass[i], inertia[i])
        for i in range(n)
    ]
    deviation("contact.momentum", np.abs(linear)[hit], 1e-10)
    deviation("contact.momentum", np.abs(turning)[hit], 1e-10)
    energy = [
        0.5 * np.sum(mass * (w[:, :, :3] ** 2).sum(2) + inertia * (w[:, :, 3:] ** 2).sum(2), 1)
        for w in (v, v_end)
    ]
    assert np.all(energy[1][hit] < energy[0][hit])
    assert depth.max() < 0.05


def random_scenes(n, seed):
    """Return bodies, positions, attitudes, velocities and rock of n scenes of two bodies."""
    rng = np.random.default_rng(seed)
    kind = rng.choice([SPHERE, BOX, CAPSULE], (n, 2))
    size = rng.uniform(0.08, 0.25, (n, 2, 3))
    reach = np.where(kind == BOX, np.linalg.norm(size, axis=2), size[:, :, 0])
    reach += np.where(kind == CAPSULE, size[:, :, 1], 0.0)
    mass = rng.uniform(0.5, 20.0, (n, 2))
    bodies = describe(kind[0], size[0], mass[0], mass[0])
    rows = jax.tree.map(lambda leaf: np.repeat(leaf[None], n, axis=0), bodies)
    inertia = np.repeat((0.3 * mass * size.min(axis=2) ** 2)[:, :, None], 3, axis=2)
    rows = replace(
        rows, kind=kind.astype(np.int32), size_m=size, mass_kg=mass, inertia_kgm2=inertia
    )
    p = rng.uniform(-0.4, 0.4, (n, 2, 3))
    p[:, :, 2] += 0.6
    apart = np.arange(n) % 2 == 0  # the others overlap at the start
    p[apart, :, 2] = (HEIGHT + np.cumsum(2.0 * reach, axis=1) - reach + 0.02)[apart]
    p[apart, :, :2] *= 0.3
    q = rng.normal(size=(n, 2, 4))
    q /= np.linalg.norm(q, axis=2, keepdims=True)
    v = rng.normal(0.0, 0.4, (n, 2, 6))
    occupied = rng.random((n, 4, 4, 2)) < 0.4
    occupied[:, :, :, 1] = False
    return rows, p, q, v, occupied, apart


@pytest.fixture(scope="module")
def flown():
    """Random scenes for a second in float32: states and energies of 20 times."""
    layout = lay_out(2)

    def fly(bodies, p, q, v, occupied):
        rock = Rock.of(
            Grid(
                occupied=occupied,
                origin_m=jnp.array([-1.4, -1.4, 0.0]),
                cell_m=jnp.asarray(HEIGHT),
            )
        )
        pull = jnp.array([0.0, 0.0, -G])

        def energy(now):
            p, _, v, _ = now
            kinetic = bodies.mass_kg * jnp.sum(v[:, :3] ** 2, axis=1)
            kinetic += jnp.sum(bodies.inertia_kgm2 * v[:, 3:] ** 2, axis=1)
            return jnp.sum(0.5 * kinetic + bodies.mass_kg * G * p[:, 2])

        def record(now, _):
            step = lambda _, now: advance(layout, bodies, pull, (rock, jnp.zeros(())), now)  # noqa: E731
            later = jax.lax.fori_loop(0, round(0.05 / DT), step, now)
            speed = jnp.sqrt(jnp.max(jnp.sum(later[2][:, :3] ** 2, axis=1)))
            return later, (energy(later), speed, later[3])

        begin = (p, q, v, jnp.zeros(()))
        end, seen = jax.lax.scan(record, begin, None, length=20)
        return end, energy(begin), seen

    compiled = thoroughly(jax.vmap(fly))

    def run(n, seed):
        *arrays, apart = random_scenes(n, seed)
        single = jax.tree.map(
            lambda leaf: jnp.asarray(leaf, np.float32 if leaf.dtype == float else None), arrays
        )
        return jax.device_get(compiled(*single)), apart

    return run


def check_finite_and_slow(found):
    (end, _, (_, speed, depth)), apart = found
    assert all(np.all(np.isfinite(leaf)) for leaf in end)
    assert (depth[:, -1] > 0.0).mean() > 0.9
    # A fall of a second; and bodies that begin in each other by up to 0.5 m, whose points contact
    # parts at 3 m/s at most: 12.0 m/s of a centre was measured in 1,000 scenes.
    assert speed[apart].max() < 4.0
    assert speed[~apart].max() < 20.0


@pytest.fixture(scope="module")
def scenes(flown):
    return flown(SCENES, 0)


def test_random_scenes_of_overlapping_bodies_stay_finite_and_slow(scenes):
    check_finite_and_slow(scenes)


@pytest.mark.nightly(by="test_random_scenes_of_overlapping_bodies_stay_finite_and_slow")
def test_a_thousand_random_scenes_stay_finite_and_slow(flown):
    check_finite_and_slow(flown(1000, 1))


def test_contact_gives_bodies_that_fall_no_energy(scenes):
    """Spheres gain none; a few scenes of other shapes do, for a cause that is not established."""
    (_, start, (energy, _, depth)), apart = scenes
    kind = random_scenes(SCENES, 0)[0].kind
    gain = (energy - start[:, None]).max(axis=1) / (np.abs(start) + 1.0)
    spheres = apart & np.all(kind == SPHERE, axis=1)
    assert spheres.sum() >= 5
    assert gain[spheres].max() < 1e-3
    assert (gain[apart] > 0.01).mean() < 0.03
    assert np.median(energy[apart, -1] - start[apart]) < 0.0
    assert np.percentile(depth[apart, -1], 99) < 0.08
