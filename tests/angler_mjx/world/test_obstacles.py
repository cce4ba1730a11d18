"""How obstacles move, what the water does to their shapes, and how they are drawn."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.world import currents, obstacles
from angler_mjx.world.obstacles import bodies as obstacle_bodies
from angler_mjx.world.obstacles.explicit import explicit_rows
from angler_mjx.world.rock.grid import Grid

from ..compiling import quickly

RHO, G = 1025.0, 9.81
LO, HI = np.array([-12.0, -12.0, -26.0]), np.array([12.0, 12.0, 2.0])
VORTEX = currents.Vortices(
    centre_m=jnp.zeros((1, 2)), circulation_m2ps=jnp.full(1, 4.0), core_m=jnp.ones(1)
)
# At a wall the position is put back: one step's length is lost, and some float32 rounding.
PUT_BACK = 0.5 * 0.02 + 1e-5
STILL = (currents.Uniform(velocity_mps=jnp.zeros(3)),)


def rows(*entries):
    config = parse_model(obstacles.ObstaclesConfig, {"explicit": list(entries)}, source="test")
    return explicit_rows(config.explicit, RHO)


def grid(occupied=None):
    occupied = np.zeros((16, 16, 16), bool) if occupied is None else occupied
    return Grid(
        occupied=jnp.asarray(occupied),
        origin_m=jnp.array([-12.0, -12.0, -26.0]),
        cell_m=jnp.array(1.5),
    )


_reset = quickly(obstacles.reset)


@quickly
def _advance(body, state, current, t, dt, n, cells, gravity):
    def one(k, state):
        return obstacles.step(
            body,
            state,
            current,
            t + k * dt,
            dt,
            jnp.asarray(LO, state.p.dtype),
            jnp.asarray(HI, state.p.dtype),
            cells,
            RHO,
            gravity,
        )

    return jax.lax.fori_loop(0, n, one, state)


def roll(body, current, duration, dt, *, every=None, cells=None, gravity=G):
    """States at 0, every, 2 every ... duration, as a list."""
    cells = grid() if cells is None else cells
    every = duration if every is None else every
    n = round(every / dt)
    states = [_reset(body, current, RHO, gravity)]
    for i in range(round(duration / every)):
        t = jnp.asarray(i * every, float)
        states.append(
            _advance(body, states[-1], current, t, jnp.asarray(dt, float), n, cells, gravity)
        )
    return states


def sphere(p, *, radius=0.3, mass=None, **motion):
    entry = {"type": "sphere", "radius_m": radius, "position_m": list(p), "motion": motion}
    return entry if mass is None else entry | {"mass_kg": mass}


DRIFT = partial(sphere, type="drift")


def test_neutral_sphere_keeps_its_orbit_in_a_vortex():
    with jax.enable_x64(True):
        vortex = jax.tree.map(lambda x: jnp.asarray(x, float), (VORTEX,))
        body = rows(DRIFT([2.0, 0.0, -8.0]))
        distance = {}
        for dt in (0.04, 0.02):
            states = roll(body, vortex, 60.0, dt, every=5.0)
            path = np.array([state.p[0] for state in states])
            distance[dt] = np.linalg.norm(path[:, :2], axis=1)
            np.testing.assert_allclose(path[:, 2], -8.0, atol=1e-9)
        v, _ = currents.evaluate_current(vortex, jnp.array([2.0, 0.0, -8.0]), jnp.array(0.0))
        assert 60.0 * float(v[1]) > 2 * np.pi * 2, "more than one turn"
        off = {dt: np.abs(r - 2.0).max() for dt, r in distance.items()}
        # The scheme is of second order: the error falls by four, and is what halving shows.
        assert off[0.04] / off[0.02] == pytest.approx(4.0, rel=0.15)
        # A third of the difference of the two is the error of the finer one: 7e-5 m.
        assert off[0.02] < 1e-4

        # Without the pressure gradient of the turning flow (no displaced volume, so no weight
        # either) the same body is flung out.
        bare = replace(body, volume_m3=jnp.zeros(1))
        end = roll(bare, vortex, 60.0, 0.02, every=5.0, gravity=0.0)[-1]
        assert np.linalg.norm(end.p[0, :2]) > 4.0


def test_sphere_catches_up_with_a_uniform_current_by_quadratic_drag():
    speed, radius = 0.4, 0.5
    current = (currents.Uniform(velocity_mps=jnp.array([speed * 0.6, 0.0, speed * 0.8])),)
    v = np.asarray(current[0].velocity_mps)
    body = rows(DRIFT([-3.0, 0.0, -20.0], radius=radius, relative_velocity_mps=(-v).tolist()))
    states = roll(body, current, 20.0, 0.02, every=5.0)
    mass = RHO * 4 / 3 * np.pi * radius**3
    k = 0.5 * RHO * 0.47 * np.pi * radius**2 / (1.5 * mass)
    for i, state in enumerate(states):
        lag = speed / (1 + k * speed * 5.0 * i)
        # First (Euler) step: k speed^2 dt / 2 of 6e-6 relative; float32 over 1,000 steps: 1e-5.
        np.testing.assert_allclose(state.nu[0, :3], v * (1 - lag / speed), atol=3e-5)
    travelled = speed * 20.0 - np.log(1 + k * speed * 20.0) / k
    np.testing.assert_allclose(states[-1].p[0], [-3, 0, -20] + v / speed * travelled, atol=1e-3)


def test_drag_of_a_sphere_does_not_depend_on_its_attitude():
    lag = [0.3, -0.2, 0.0]
    turned = DRIFT([0.0, 0.0, -10.0], relative_velocity_mps=lag) | {"rpy_deg": [30.0, 50.0, 70.0]}
    body = rows(DRIFT([0.0, 0.0, -10.0], relative_velocity_mps=lag), turned)
    end = roll(body, STILL, 10.0, 0.02)[-1]
    np.testing.assert_allclose(end.p[0], end.p[1], atol=2e-5)  # float32 over 500 steps
    assert np.linalg.norm(end.p[0] - jnp.array([0.0, 0.0, -10.0])) > 1.0


def test_buoyant_sphere_rises_at_its_terminal_speed_and_floats():
    radius, lighter = 0.5, 0.97
    volume = 4 / 3 * np.pi * radius**3
    mass = lighter * RHO * volume
    body = rows(DRIFT([0.0, 0.0, -20.0], radius=radius, mass=mass))
    states = roll(body, STILL, 70.0, 0.02, every=10.0)
    drag = 0.5 * RHO * 0.47 * np.pi * radius**2
    terminal = np.sqrt((RHO * volume - mass) * G / drag)
    rate = np.sqrt((RHO * volume - mass) * G * drag) / (mass + 0.5 * RHO * volume)
    # u = U tanh(t U k): after 10 s the sphere moves within tanh of it; float32 gives 1e-5.
    assert float(states[1].nu[0, 2]) == pytest.approx(terminal * np.tanh(10 * rate), rel=1e-4)
    # At rest the submerged share carries the weight: 0.5 - z / (2 r) = 0.97. The bobbing has died
    # down to a centimetre or so after the ascent of 25 s.
    assert float(states[-1].p[0, 2]) == pytest.approx((0.5 - lighter) * 2 * radius, abs=0.05)


def test_scripted_movers_follow_their_closed_forms():
    period, w = 17.0, 2 * np.pi / 17.0
    line = sphere([-10.0, 2.0, -6.0], type="straight", velocity_mps=[0.8, -0.3, 0.1])
    swing = sphere(
        [1.0, 2.0, -5.0], type="sine", amplitude_m=[1, 0, 2], period_s=period, phase_deg=30
    )
    ring = sphere(
        [3.0, 0.0, -9.0],
        type="circle",
        radius_m=2.0,
        period_s=period,
        phase_deg=90,
        clockwise=True,
    )
    rest = sphere([5.0, 5.0, -9.0], type="static")
    body = rows(line, swing, ring, rest)
    states = roll(body, (), 60.0, 0.05, every=7.5)
    lo, hi = LO + 0.3, HI - 0.3
    for i, state in enumerate(states):
        t = 7.5 * i
        # Reflected path: unfold the line and fold it back, one wall at a time.
        p, v = np.array([-10.0, 2.0, -6.0]) + t * np.array([0.8, -0.3, 0.1]), [0.8, -0.3, 0.1]
        v = np.array(v)
        for _ in range(5):
            past, under = p > hi, p < lo
            p = np.where(past, 2 * hi - p, np.where(under, 2 * lo - p, p))
            v = np.where(past | under, -v, v)
        angle, turn = w * t + np.pi / 6, np.pi / 2 + w * t
        want_p = [
            p,
            np.array([1, 2, -5]) + np.sin(angle) * np.array([1, 0, 2]),
            np.array([3, 0, -9]) + 2 * np.array([np.cos(turn), -np.sin(turn), 0]),
            np.array([5, 5, -9]),
        ]
        want_v = [
            v,
            w * np.cos(angle) * np.array([1, 0, 2]),
            -2 * w * np.array([np.sin(turn), np.cos(turn), 0]),
            np.zeros(3),
        ]
        # float32 of positions up to 60 m along the unfolded line and of angles up to 24 rad
        np.testing.assert_allclose(state.p, want_p, atol=3e-5)
        np.testing.assert_allclose(state.nu[:, :3], want_v, atol=1e-5)


def test_bounds_throw_a_body_back_without_loss():
    body = rows(DRIFT([11.0, 0.0, -10.0], relative_velocity_mps=[0.5, 0.2, 0.0]))
    body = replace(body, D_q=jnp.zeros_like(body.D_q))  # nothing else takes energy
    end = roll(body, STILL, 4.0, 0.02)[-1]
    np.testing.assert_allclose(end.nu[0, :3], [-0.5, 0.2, 0.0], atol=1e-6)
    assert float(end.p[0, 0]) == pytest.approx(11.7 - (2.0 - 0.7), abs=PUT_BACK)


def test_cells_throw_a_body_back_without_loss():
    occupied = np.zeros((16, 16, 16), bool)
    occupied[10:, :, :] = True  # a wall at x = 3
    body = rows(DRIFT([2.0, 0.0, -10.0], relative_velocity_mps=[0.5, 0.2, -0.1]))
    body = replace(body, D_q=jnp.zeros_like(body.D_q))
    end = roll(body, STILL, 4.0, 0.02, cells=grid(occupied))[-1]
    np.testing.assert_allclose(end.nu[0, :3], [-0.5, 0.2, -0.1], atol=1e-6)
    assert float(end.p[0, 0]) == pytest.approx(2.7 - (2.0 - 0.7), abs=PUT_BACK)


def test_nothing_drifts_through_rock_and_all_stay_inside():
    rng = np.random.default_rng(0)
    occupied = rng.random((16, 16, 16)) < 0.1
    config = parse_model(obstacles.ObstaclesConfig, {"dynamic": {"count": 48}}, source="test")
    cells = grid(occupied)
    body = quickly(
        lambda key: obstacles.sample_obstacles(
            config.explicit,
            obstacles.DriftingSampler.of(config.dynamic),
            key,
            cells,
            jnp.asarray(LO),
            jnp.asarray(HI),
            jnp.zeros((0, 3)),
            0.0,
            RHO,
        )
    )(jax.random.key(0))
    storm = (
        currents.Uniform(velocity_mps=jnp.array([0.4, 0.2, 0.05])),
        replace(VORTEX, circulation_m2ps=jnp.full(1, 8.0)),
    )
    radius = np.asarray(jax.vmap(obstacles.bounding_radius)(body.kind, body.size_m))
    low = np.array([-12.0, -12.0, -26.0]) + 1.5 * np.argwhere(occupied)
    moved = 0.0
    for state in roll(body, storm, 120.0, 0.02, every=5.0, cells=cells):
        p = np.asarray(state.p)
        gap = np.linalg.norm(p[:, None] - np.clip(p[:, None], low, low + 1.5), axis=2).min(axis=1)
        # Put back from the nearest cell each step; in a corner of two cells the second one may be
        # entered by what the first one pushes: a step's length, 0.02 s of less than 2 m/s.
        assert np.all((gap - radius)[np.asarray(body.exists)] > -0.04)
        assert np.all((p >= LO + radius[:, None] - 1e-5) & (p <= HI - radius[:, None] + 1e-5))
        moved = np.linalg.norm(p - np.asarray(body.p0), axis=1).mean()
    assert moved > 1.0


def samples(inside, half, n=4_000_000):
    """Volume and principal second moments over volume of a shape, by even sampling."""
    side = round(n ** (1 / 3))
    axis = (np.arange(side) + 0.5) / side * 2 - 1
    p = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) * half
    p = p[inside(p)]
    volume = np.prod(2 * np.array(half)) * len(p) / side**3
    square = (p * p).mean(axis=0)
    return volume, square.sum() - square


@pytest.mark.parametrize(
    ("body", "half", "inside"),
    [
        (
            obstacle_bodies.build_sphere(0.6),
            [0.6] * 3,
            lambda p: (p * p).sum(axis=1) < 0.36,
        ),
        (obstacle_bodies.build_box((0.3, 0.5, 0.9)), [0.3, 0.5, 0.9], lambda p: p[:, 0] < 1),
        (
            obstacle_bodies.build_capsule(0.4, 0.7),
            [0.4, 0.4, 1.1],
            lambda p: (p[:, :2] ** 2).sum(axis=1) + np.maximum(abs(p[:, 2]) - 0.7, 0) ** 2 < 0.16,
        ),
    ],
)
def test_volume_and_inertia_are_those_of_the_shape(body, half, inside):
    volume, inertia = samples(inside, half)
    # 160 samples along each axis: surface cells are half in, half out, on average.
    assert body.volume_m3 == pytest.approx(volume, rel=2e-3)
    np.testing.assert_allclose(body.inertia_m2, inertia, rtol=2e-3)


@pytest.mark.parametrize("slenderness", [1.0, 1.001, 1.5, 4.0])
def test_added_mass_of_a_capsule_is_lambs_spheroid(slenderness):
    radius = 0.4
    body = obstacle_bodies.build_capsule(radius, radius * (slenderness - 1))
    # Lamb's integrals by quadrature over lambda = b^2 x / (1 - x).
    b = (body.volume_m3 / (4 / 3 * np.pi * slenderness)) ** (1 / 3)
    a = b * slenderness
    x = (np.arange(200_000) + 0.5) / 200_000
    lam, weight = b * b * x / (1 - x), b * b / (1 - x) ** 2 / len(x)
    common = a * b * b * weight / ((b * b + lam) * np.sqrt(a * a + lam))
    alpha, beta = (common / (a * a + lam)).sum(), (common / (b * b + lam)).sum()
    want = body.volume_m3 * np.array([beta / (2 - beta), alpha / (2 - alpha)])
    # Midpoint rule with an integrable end: 1e-4; the series near the sphere: 1e-5.
    np.testing.assert_allclose(body.added[[0, 2]], want, rtol=5e-4)
    if slenderness > 1.1:
        gap, d, s = beta - alpha, a * a - b * b, a * a + b * b
        turn = 0.2 * body.volume_m3 * d * d * gap / (2 * d - s * gap)
        assert body.added[3] == pytest.approx(turn, rel=5e-3)
    assert np.all(body.added >= 0)


def test_round_and_square_shapes_have_their_textbook_coefficients():
    ball, cube = obstacle_bodies.build_sphere(0.5), obstacle_bodies.build_box((0.5, 0.5, 0.5))
    np.testing.assert_allclose(ball.added[:3], 0.5 * ball.volume_m3)
    np.testing.assert_allclose(cube.added[:3], 0.68)
    np.testing.assert_allclose(cube.drag[:3], 1.05)
    stub = obstacle_bodies.build_capsule(0.5, 0.0)
    for name in ("inertia_m2", "added", "drag"):
        np.testing.assert_allclose(getattr(stub, name), getattr(ball, name), rtol=1e-12, atol=1e-12)
    plate = obstacle_bodies.build_box((1e-4, 0.5, 0.5))
    # A square plate moving broadside: 0.579 of pi/4 side^3; its thickness adds 1e-4 of that.
    assert plate.added[0] == pytest.approx(0.579 * np.pi / 4, rel=1e-3)
    # Rotating strips against direct integration of |omega x| omega x x over a face.
    h = (0.2, 0.5, 0.8)
    x, step = np.linspace(-h[2], h[2], 20001, retstep=True)
    y, step_y = np.linspace(-h[1], h[1], 20001, retstep=True)
    faces = (abs(x) ** 3).sum() * step + (abs(y) ** 3).sum() * step_y
    assert obstacle_bodies.build_box(h).drag[3] == pytest.approx(1.05 * 2 * h[0] * faces, rel=1e-3)


def draw_many(config, n_world, occupied, keep_out, keep_out_radius):
    cells = grid(occupied)

    def one(key):
        return obstacles.sample_obstacles(
            config.explicit,
            obstacles.DriftingSampler.of(config.dynamic),
            key,
            cells,
            jnp.asarray(LO),
            jnp.asarray(HI) - jnp.array([0.0, 0.0, 4.0]),
            jnp.asarray(keep_out),
            keep_out_radius,
            RHO,
        )

    return quickly(jax.vmap(one))(jax.random.split(jax.random.key(1), n_world))


def test_drawn_obstacles_start_free_and_keep_their_shares():
    rng = np.random.default_rng(1)
    occupied = rng.random((16, 16, 16)) < 0.1
    occupied[:, :, 8] = False
    low = np.array([-12.0, -12.0, -26.0]) + 1.5 * np.argwhere(occupied)
    keep_out = rng.uniform([-11, -11, -25], [11, 11, -3], (8, 3)).astype(np.float32)
    config = parse_model(
        obstacles.ObstaclesConfig,
        {
            "dynamic": {
                "count": 20,
                "cube_fraction": 0.3,
                "rise_fraction": 0.25,
                "sink_fraction": 0.4,
            },
            "explicit": [{"type": "box", "position_m": [0, 0, -13.25], "size_m": [6, 9, 1.4]}],
        },
        source="test",
    )
    drawn = draw_many(config, 60, occupied, keep_out, 0.8)
    assert drawn.kinds == (obstacles.SPHERE, obstacles.BOX)
    assert drawn.motions == (obstacles.STATIC, obstacles.DRIFT)
    part = jax.tree.map(lambda x: np.asarray(x)[:, 1:], drawn)
    there = part.exists
    assert there.mean() > 0.95
    cube = part.kind == obstacles.BOX
    size = np.linalg.norm(part.size_m, axis=2)
    assert size.min() >= 0.4 - 1e-6
    assert size.max() <= 0.75 + 1e-6
    p = part.p0
    gap = np.full(p.shape[:2], np.inf)
    for corner in low:
        gap = np.minimum(gap, np.linalg.norm(p - np.clip(p, corner, corner + 1.5), axis=2))
    assert np.all((gap - size)[there] > -1e-5)
    away = np.linalg.norm(p[:, :, None] - keep_out, axis=3).min(axis=2)
    assert np.all((away - size)[there] > 0.8 - 1e-5)
    slab = np.clip(p, [-3, -4.5, -13.95], [3, 4.5, -12.55])
    assert np.all((np.linalg.norm(p - slab, axis=2) - size)[there] > -1e-5)
    apart = np.linalg.norm(p[:, :, None] - p[:, None], axis=3) - size[:, :, None] - size[:, None]
    apart[:, np.arange(20), np.arange(20)] = np.inf
    apart[~there] = np.inf
    assert np.mean(apart.min(axis=2) < 0) < 0.02, "room enough for nearly all of them"

    n = cube.size
    excess = part.mass_kg / (RHO * part.volume_m3) - 1
    for share, got in ((0.3, cube), (0.25, excess < -1e-6), (0.4, excess > 1e-6)):
        # Four standard errors of a share of n independent bodies.
        assert np.mean(got) == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / n))
    half = size / np.sqrt(3)
    volume = np.where(cube, 8 * half**3, 4 / 3 * np.pi * size**3)
    np.testing.assert_allclose(part.volume_m3, volume, rtol=1e-5)
    moment = part.mass_kg * np.where(cube, 2 / 3 * half**2, 0.4 * size**2)
    np.testing.assert_allclose(part.inertia_kgm2, moment[..., None] * np.ones(3), rtol=1e-5)
    added = np.where(cube, 0.68, 0.5) * RHO * volume
    np.testing.assert_allclose(part.M_A[..., :3], added[..., None] * np.ones(3), rtol=1e-5)
    area = np.where(cube, 1.05 * 4 * half**2, 0.47 * np.pi * size**2)
    np.testing.assert_allclose(part.D_q[..., 2], 0.5 * RHO * area, rtol=1e-5)
    # Steady vertical speed from the balance of forces; the excess is a difference of numbers near
    # 1 in float32, 1e-7 of 5e-5 at the slowest.
    speed = np.sqrt(np.abs(excess) * RHO * part.volume_m3 * 9.80665 / part.D_q[..., 2])
    moving = np.abs(excess) > 1e-6
    assert speed[moving].min() > 0.02 * 0.98
    assert speed[moving].max() < 0.1 * 1.02


def test_no_place_means_no_obstacle():
    config = parse_model(obstacles.ObstaclesConfig, {"dynamic": {"count": 3}}, source="test")
    full = draw_many(config, 2, np.ones((16, 16, 16), bool), np.zeros((1, 3)), 1.0)
    assert not np.any(full.exists)


def test_an_empty_config_gives_one_row_of_padding():
    empty = draw_many(obstacles.ObstaclesConfig(), 2, None, np.zeros((1, 3)), 1.0)
    assert empty.kind.shape == (2, 1)
    assert not np.any(empty.exists)
    assert empty.kinds == ()
    assert empty.motions == ()


def test_explicit_obstacles_are_read_as_written():
    body = rows(
        {
            "type": "box",
            "position_m": [1, 2, -3],
            "size_m": [1, 2, 3],
            "rpy_deg": [90, 0, 90],
            "motion": {"type": "drift", "relative_velocity_mps": [0.1, 0.2, 0.3]},
            "mass_kg": 700,
        },
        {"type": "capsule", "position_m": [0, 0, -4], "radius_m": 0.2, "length_m": 1.0},
    )
    np.testing.assert_allclose(body.size_m, [[0.5, 1.0, 1.5], [0.2, 0.5, 0.0]])
    np.testing.assert_allclose(body.mass_kg[0], 700)
    np.testing.assert_allclose(body.inertia_kgm2[0], 700 / 12 * np.array([13, 10, 5]), rtol=1e-6)
    np.testing.assert_allclose(
        body.mass_kg[1], RHO * (np.pi * 0.04 + 4 / 3 * np.pi * 0.008), rtol=1e-6
    )
    # Rolled by 90 degrees about x, then turned by 90 degrees about z: the body's x points north,
    # its y up, its z east.
    np.testing.assert_allclose(body.nu0[0, :3], [0.2, 0.3, 0.1], atol=1e-6)


def test_every_fault_of_a_file_is_told():
    data = {
        "dynamic": {"count": -1, "radius_m": [0.7, 0.4]},
        "explicit": [
            {"type": "sphere", "position_m": [0, 0, 0], "radius_m": -1},
            {"type": "box", "position_m": [0, 0, 0], "size_m": [1, 1, 1], "mass_kg": -5},
            {"type": "cone", "position_m": [0, 0, 0]},
        ],
    }
    with pytest.raises(ConfigError) as error:
        parse_model(obstacles.ObstaclesConfig, data, source="test")
    for words in ("dynamic.count", "radius_m", "mass_kg", "cone"):
        assert words in str(error.value)
    with pytest.raises(ConfigError, match="low <= high"):
        parse_model(obstacles.ObstaclesConfig, {"dynamic": {"radius_m": [0.7, 0.4]}}, source="test")
    with pytest.raises(ConfigError, match="axis"):
        rows(sphere([0, 0, 0], type="circle", radius_m=1, period_s=1, axis=[0, 0, 0]))
