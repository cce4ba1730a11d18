"""Vehicles with arms: equations against Pinocchio and against a recursion, and the step itself."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from angler_kernels import quaternion, spd_solve
from angler_mjx.robot.vehicles import library, mjcf, params
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim.physics import joints as efforts
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.prescribed import accelerate_base
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.world.currents import Uniform, Vortices

from ...compiling import quickly
from . import armed as arms
from .plants import WATER

STATES = 1000
VACUUM = Water(density_kgpm3=0.0)


@pytest.fixture(scope="module", params=["shipped", "branched"])
def armed(request, x64):
    config = library.load_vehicle(arms.SHIPPED) if request.param == "shipped" else arms.branched()
    return arms.build(config, "wu2018")


@pytest.fixture(scope="module")
def shipped(x64):
    return arms.build(library.load_vehicle(arms.SHIPPED), "von_benzon2022")


def relative(a, b):
    """Largest error of rows, each over the largest number of its row."""
    a, b = (np.reshape(x, (len(x), -1)) for x in (a, b))
    return np.max(np.max(np.abs(a - b), axis=1) / np.max(np.abs(b), axis=1))


def dry(armed, states, dtype):
    """Inertia [k, n, n] and force [k, n] of the vehicle in vacuum."""
    vehicle = arms.cast(arms.in_vacuum(armed.params), dtype)

    def evaluate(p, q, nu, theta, speed):
        state = VehicleState(
            p=p,
            q=q,
            nu=nu,
            force_before=jnp.zeros(0),
            thrust=jnp.zeros(0),
            joints=arms.motion(theta, speed),
        )
        flow = jnp.zeros_like(p)
        forces = physics.join_forces(vehicle, state, flow, flow, VACUUM)
        return forces.M, forces.force

    names = ("p", "q", "nu", "theta", "speed")
    return quickly(jax.vmap(evaluate))(*(jnp.asarray(states[name], dtype) for name in names))


def test_dry_dynamics_are_those_of_pinocchio(armed, deviation):
    states = arms.sample_states(armed, STATES, 1)
    chain = armed.chain
    model = arms.to_pinocchio(chain)
    data, columns = model.createData(), arms.pinocchio_columns(model, chain.order)
    zeros = np.array([chain.tables[name].zero for name in chain.order])
    inertia, force, acceleration = [], [], []
    for p, q, nu, theta, speed in zip(
        *(states[name] for name in ("p", "q", "nu", "theta", "speed")), strict=True
    ):
        position, velocity = np.zeros(model.nq), np.zeros(model.nv)
        position[:7], velocity[columns] = [*p, *q[1:], q[0]], [*nu, *speed]
        position[columns[6:] + 1] = theta - zeros
        upper = np.triu(pin.crba(model, data, position))
        full = upper + np.triu(upper, 1).T
        inertia.append(full[np.ix_(columns, columns)])
        force.append(-pin.nonLinearEffects(model, data, position, velocity)[columns])
        acceleration.append(pin.aba(model, data, position, velocity, np.zeros(model.nv))[columns])
    for dtype, tolerance in ((jnp.float64, 1e-9), (jnp.float32, 1e-4)):
        with jax.enable_x64(dtype == jnp.float64):
            ours = dry(armed, states, dtype)
        assert ours[0].dtype == dtype
        bits = jnp.finfo(dtype).bits
        deviation(f"links.inertia_{bits}", relative(ours[0], np.array(inertia)), tolerance)
        deviation(f"links.bias_{bits}", relative(ours[1], np.array(force)), tolerance)
        if dtype == jnp.float64:  # float32 loses more in the solution for light joints
            solved = np.linalg.solve(ours[0], np.asarray(ours[1])[:, :, None])[:, :, 0]
            deviation("links.acceleration", relative(solved, np.array(acceleration)), tolerance)


def test_dry_dynamics_are_those_of_the_mujoco_model(armed, deviation):
    states = arms.sample_states(armed, STATES, 1)
    model = mjx_engine.compile_models([mjcf.to_spec(armed.config, armed.set_name, shapes=False)])[0]
    judged = [
        arms.mujoco_inertia_and_force(model, *state)
        for state in zip(*(states[k] for k in ("p", "q", "nu", "theta", "speed")), strict=True)
    ]
    ours = dry(armed, states, jnp.float64)
    for value, ones in zip(ours, zip(*judged, strict=True), strict=True):
        deviation("links.mujoco", relative(value, np.array(ones)), 1e-9)


def residual(armed, dtype, states, accelerations):
    """Efforts [k, n] that a motion asks for, from the simulator's own inertia and force."""
    vehicle = arms.cast(armed.params, dtype)

    def evaluate(p, q, nu, theta, speed, flow, flow_rate, acceleration):
        state = VehicleState(
            p=p,
            q=q,
            nu=nu,
            force_before=jnp.zeros(0),
            thrust=jnp.zeros(0),
            joints=arms.motion(theta, speed),
        )
        forces = physics.join_forces(vehicle, state, flow, flow_rate, WATER)
        return jnp.sum(forces.M * acceleration, axis=1) - forces.force

    names = ("p", "q", "nu", "theta", "speed", "flow", "flow_rate")
    arrays = [*(states[name] for name in names), accelerations]
    return quickly(jax.vmap(evaluate))(*(jnp.asarray(x, dtype) for x in arrays))


@pytest.fixture(scope="module")
def motions(armed):
    """States, accelerations [k, n], and the efforts [k, n] of the recursion."""
    states = arms.sample_states(armed, STATES, 2)
    accelerations = np.random.default_rng(3).normal(size=(STATES, 6 + armed.count))
    names = ("p", "q", "nu", "theta", "speed")
    chain = armed.chain
    asked = [
        chain.inverse(*state, acc[:6], acc[6:], flow, rate)
        for *state, acc, flow, rate in zip(
            *(states[name] for name in names),
            accelerations,
            states["flow"],
            states["flow_rate"],
            strict=True,
        )
    ]
    return states, accelerations, np.array(asked)


@pytest.mark.parametrize(("dtype", "tolerance"), [("float64", 1e-9), ("float32", 1e-4)])
def test_wet_dynamics_are_those_of_a_recursion(armed, motions, dtype, tolerance, deviation):
    states, accelerations, asked = motions
    with jax.enable_x64(dtype == "float64"):
        ours = residual(armed, jnp.dtype(dtype), states, accelerations)
    assert ours.dtype == dtype
    bits = jnp.finfo(dtype).bits
    deviation(f"links.wrench_{bits}", relative(ours[:, :6], asked[:, :6]), tolerance)
    deviation(f"links.effort_{bits}", relative(ours[:, 6:], asked[:, 6:]), tolerance)


def test_prescribed_joints_leave_the_equation_of_the_base(armed, motions, deviation):
    states, accelerations, asked = motions
    names = ("p", "q", "nu", "theta", "speed", "flow", "flow_rate")

    def evaluate(p, q, nu, theta, speed, flow, flow_rate, joint_acceleration, wrench):
        return accelerate_base(
            armed.params,
            p,
            q,
            nu,
            arms.motion(theta, speed),
            joint_acceleration,
            wrench=wrench,
            v_c=flow,
            Dv_c=flow_rate,
        )

    arrays = [*(states[name] for name in names), accelerations[:, 6:], asked[:, :6]]
    ours = quickly(jax.vmap(evaluate))(*map(jnp.asarray, arrays))
    deviation("links.prescribed", relative(ours, accelerations[:, :6]), 1e-9)


def test_prescribed_joints_have_derivatives_by_all_parameters(shipped):
    states = {k: jnp.asarray(v[0]) for k, v in arms.sample_states(shipped, 1, 4).items()}
    params = shipped.params
    names = ("M_A", "D_l", "D_q", "p_cb_m", "volume_m3", "mass_kg", "inertia_kgm2")
    link_names = (
        *("mass_kg", "center_of_mass_m", "inertia_kgm2", "volume_m3", "center_of_buoyancy_m"),
        *("M_A", "added_volume", "normal_area_m2", "axial_area_m2", "zero", "position_m"),
    )

    def scaled(factors):
        links = {k: getattr(params.links, k) * (1 + factors[f"links.{k}"]) for k in link_names}
        own = {k: getattr(params, k) * (1 + factors[k]) for k in names}
        return replace(params, **own, links=replace(params.links, **links))

    def cost(factors):
        motion = arms.motion(states["theta"], states["speed"])
        state = states["p"].at[2].set(-5.0), states["q"], states["nu"]
        acceleration = accelerate_base(scaled(factors), *state, motion, jnp.ones(shipped.count))
        return jnp.sum(acceleration * jnp.arange(1.0, 7.0))

    factors = dict.fromkeys([*names, *(f"links.{k}" for k in link_names)], jnp.zeros(()))
    evaluate = quickly(jax.value_and_grad(cost))
    gradient = evaluate(factors)[1]
    for name in factors:
        low, high = ({**factors, name: jnp.asarray(np.float64(sign * 1e-5))} for sign in (-1, 1))
        difference = float(evaluate(high)[0] - evaluate(low)[0]) / 2e-5
        assert float(gradient[name]) == pytest.approx(difference, rel=1e-5, abs=1e-8), name
        if name != "links.M_A":  # zero in the file
            assert gradient[name] != 0.0, name


def total_momentum(chain, p, q, nu, theta, speed):
    """Momentum [6] about the world's origin, in W, and kinetic energy, body by body."""
    from .recursive import frame, to_matrix, turn

    by_name = dict(zip(chain.order, zip(theta, speed, strict=True), strict=True))
    total, energy = np.zeros(6), 0.0
    bodies = {"base": (p, to_matrix(q), to_matrix(q) @ nu[:3], to_matrix(q) @ nu[3:])}
    for link in chain.config.find_links(None):
        place, R, v, omega = bodies[link.parent]
        offset = np.array(link.position_m)
        if link.parent == "base":
            offset = offset - chain.config.base.center_of_mass_m
        R_link, joint = R @ frame(link.rpy_rad), chain.tables.get(link.joint)
        arm, slide, spin = R @ offset, np.zeros(3), np.zeros(3)
        if joint is not None:
            angle, rate = by_name[joint.name]
            axis = R_link @ joint.axis
            if joint.type == "prismatic":
                arm, slide = arm + axis * (angle - joint.zero), axis * rate
            else:
                R_link, spin = R_link @ turn(joint.axis, angle - joint.zero), axis * rate
        v_link = v + np.cross(omega, arm) + slide
        bodies[link.name] = (place + arm, R_link, v_link, omega + spin)
    numbers = {"base": chain.base, **chain.bodies}
    for name, (place, R, v, omega) in bodies.items():
        body = numbers[name]
        com = R @ body.com
        v_c = v + np.cross(omega, com)
        spin = R @ body.inertia @ R.T @ omega
        total += body.mass * np.concatenate([v_c, np.cross(place + com, v_c)])
        total[3:] += spin
        energy += 0.5 * body.mass * v_c @ v_c + 0.5 * omega @ spin
    return total, energy


def test_an_arm_in_vacuum_keeps_momentum_and_takes_the_work_of_its_motors(armed, deviation):
    n_joint, vehicle = armed.count, arms.in_vacuum(armed.params)
    space = Water(density_kgpm3=0.0, gravity_mps2=0.0)

    @quickly
    def rates(t, y):
        p, q, nu = y[:3], y[3:7], y[7:13]
        theta, speed = y[13 : 13 + n_joint], y[13 + n_joint : 13 + 2 * n_joint]
        effort = 0.02 * jnp.sin(3.0 * t + jnp.arange(n_joint))
        state = VehicleState(
            p=p,
            q=q,
            nu=nu,
            force_before=jnp.zeros(0),
            thrust=jnp.zeros(0),
            joints=arms.motion(theta, speed),
        )
        forces = physics.join_forces(vehicle, state, jnp.zeros(3), jnp.zeros(3), space)
        right = forces.force.at[6:].add(effort)
        acceleration = spd_solve.solve(forces.M, right[:, None])[:, 0]
        q_rate = 0.5 * quaternion.multiply(q, jnp.concatenate([jnp.zeros(1), nu[3:]]))
        power = jnp.sum(effort * speed)[None]
        return jnp.concatenate(
            [quaternion.rotate(q, nu[:3]), q_rate, acceleration[:6], speed, acceleration[6:], power]
        )

    start = {k: v[0] for k, v in arms.sample_states(armed, 1, 5).items()}
    y = np.concatenate(
        [start["p"] / 20, start["q"], start["nu"], start["theta"], start["speed"], [0.0]]
    )
    done = solve_ivp(
        lambda t, y: np.asarray(rates(t, y)), (0.0, 1.0), y, method="DOP853", rtol=1e-12, atol=1e-13
    )

    def account(y):
        q = y[3:7] / np.linalg.norm(y[3:7])
        theta, speed = y[13 : 13 + n_joint], y[13 + n_joint : 13 + 2 * n_joint]
        return total_momentum(armed.chain, y[:3], q, y[7:13], theta, speed)

    (before, energy), (after, energy_after) = account(done.y[:, 0]), account(done.y[:, -1])
    assert np.max(np.abs(done.y[13 : 13 + n_joint, -1] - done.y[13 : 13 + n_joint, 0])) > 0.1
    change = np.abs(after - before) / np.max(np.abs(before))
    deviation("links.momentum", change, 1e-10)
    deviation("links.energy", abs(energy_after - energy - done.y[-1, -1]) / energy, 1e-10)


def make_state(armed, dt=None, theta=None, speed=None, z=-5.0):
    """A moving vehicle with its arm half way."""
    joints = armed.config.find_joints()
    middle = np.array([0.5 * (j.lower + j.upper) for j in joints])
    q = np.array([0.9, 0.2, -0.3, 0.1])
    return VehicleState(
        p=jnp.array([0.3, -0.2, z]),
        q=jnp.asarray(q / np.linalg.norm(q)),
        nu=jnp.array([0.4, -0.2, 0.1, 0.3, -0.2, 0.4]),
        force_before=jnp.zeros(6 + armed.count),
        thrust=jnp.zeros(armed.params.B.shape[1]),
        joints=arms.motion(
            middle if theta is None else theta,
            np.zeros(len(joints)) if speed is None else speed,
        ),
    )


FLOW = (
    Uniform(velocity_mps=jnp.array([0.2, -0.1, 0.05])),
    Vortices(
        centre_m=jnp.array([[0.5, -0.5]]),
        circulation_m2ps=jnp.array([3.0]),
        core_m=jnp.array([1.0]),
    ),
)


def fly(armed, vehicle, state, dt, steps, reference=None, engine=None, body=None):
    """The state after some steps, and all joint positions."""
    engine = armed.engine if engine is None else engine
    body = armed.body if body is None else body
    dtype, flow = state.p.dtype, arms.cast(FLOW, state.p.dtype)
    zero = jnp.zeros((), dtype)
    state = physics.start_multistep(engine, body, vehicle, state, flow, zero, WATER)
    thrust = jnp.linspace(-5.0, 5.0, vehicle.B.shape[1], dtype=dtype)

    def advance(state, i):
        t = i.astype(dtype) * dt
        after = physics.step(engine, body, vehicle, state, thrust, flow, t, dt, WATER, reference)
        return after, after.joints

    return jax.lax.scan(advance, state, jnp.arange(steps))


def vector_of(state):
    joints = state.joints
    parts = (state.p, state.q, state.nu, joints.position, 0.1 * joints.velocity)
    return np.concatenate([np.asarray(part) for part in parts])


def test_the_step_is_of_second_order(shipped, deviation):
    # Servos so soft that the steps resolve them, also that of the wrist, which is light.
    soft = jnp.array([1e-2, 1e-2, 1e-2, 1e-4, 1e-2])
    links = replace(
        shipped.params.links,
        max_speed=jnp.full(shipped.count, 1e3),
        max_effort=jnp.full(shipped.count, 1e3),
        stiffness=soft * shipped.params.links.stiffness,
        damping=soft * shipped.params.links.damping,
    )
    vehicle = replace(shipped.params, links=links, tau_s=jnp.asarray(0.2))
    state = make_state(shipped)
    reference = JointMotion(
        position=state.joints.position + jnp.array([0.3, -0.2, 0.2, 0.4, 0.002]),
        velocity=jnp.zeros(shipped.count),
    )

    @quickly
    def land(steps):
        dt, zero = 0.4 / steps, jnp.zeros(())
        begin = physics.start_multistep(
            shipped.engine, shipped.body, vehicle, state, FLOW, zero, WATER
        )
        thrust = jnp.linspace(-5.0, 5.0, vehicle.B.shape[1])

        def advance(i, state):
            parts = (shipped.engine, shipped.body, vehicle, state, thrust, FLOW)
            return physics.step(*parts, i * dt, dt, WATER, reference)

        return jax.lax.fori_loop(0, steps, advance, begin)

    ends = [vector_of(land(steps)) for steps in (100, 200, 400, 3200)]
    errors = [np.linalg.norm(end - ends[-1]) for end in ends[:-1]]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    deviation("links.order", np.abs(orders - 2.0), 0.15, about=f"{errors}, {orders}")


@pytest.mark.nightly(by="test_links.py::test_prescribed_joints_have_derivatives_by_all_parameters")
def test_gradients_through_the_step_are_those_of_differences(shipped):
    state = make_state(shipped)

    def cost(numbers):
        links = shipped.params.links
        vehicle = replace(
            shipped.params,
            D_q=shipped.params.D_q * numbers[0],
            links=replace(
                links,
                stiffness=links.stiffness * numbers[1],
                added_volume=links.added_volume * numbers[2],
                normal_area_m2=links.normal_area_m2 * numbers[3],
                volume_m3=links.volume_m3 * numbers[4],
            ),
        )
        reference = JointMotion(position=0.9 * state.joints.position, velocity=jnp.zeros(5))
        end = fly(shipped, vehicle, state, 0.01, 20, reference)[0]
        return jnp.sum(end.p) + jnp.sum(end.nu**2) + jnp.sum(end.joints.position)

    ones = jnp.ones(5)
    evaluate = quickly(jax.value_and_grad(cost))
    gradient = evaluate(ones)[1]
    for i in range(5):
        step = 1e-5 * jnp.eye(5)[i]
        difference = (evaluate(ones + step)[0] - evaluate(ones - step)[0]) / 2e-5
        assert float(gradient[i]) == pytest.approx(float(difference), rel=1e-5), i


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_stiff_servos_and_light_jaws_stay_within_their_limits(shipped, dtype):
    links = shipped.params.links
    links = replace(
        links,
        stiffness=jnp.array([1e4, 1e4, 1e5, 1e4, 1e6]),
        damping=jnp.array([1e2, 1e3, 1e3, 1.0, 1e4]),
        coulomb_friction=jnp.array([0.0, 1.0, 0.5, 0.1, 1.0]),
        max_effort=jnp.array([1e3, 1e2, 1e3, 9.0, 1e3]),
        max_speed=jnp.array([2.0, 2.0, 5.0, 5.0, 1.0]),
        mass_kg=links.mass_kg.at[-1].set(1e-3),
        inertia_kgm2=links.inertia_kgm2.at[-1].set(1e-7 * jnp.eye(3)),
    )
    span = links.upper - links.lower
    targets = links.lower + span * jnp.asarray(
        np.random.default_rng(7).uniform(-0.3, 1.3, (8, shipped.count))
    )
    vehicle, before = replace(shipped.params, links=links), make_state(shipped)
    low, high, margin = (np.asarray(x) for x in (links.lower, links.upper, 0.06 * span))
    settled = np.clip(targets[-1], low, high)
    # MJX's constants are of the default type, so float32 is float32 only where float64 is off.
    with jax.enable_x64(dtype == "float64"):
        parts = (vehicle, before, shipped.body, shipped.engine)
        vehicle, before, body, engine = (arms.cast(part, dtype) for part in parts)
        advance = quickly(partial(fly, shipped, vehicle, steps=100, engine=engine, body=body))
        for dt in (0.01, 0.02):
            state = before
            for target in np.asarray(targets)[[0, 1, 2, 3, 4, 5, 6, 7, 7, 7]]:  # time to arrive
                reference = arms.cast(arms.motion(target, np.zeros(shipped.count)), dtype)
                state, path = advance(state, dt=jnp.asarray(dt, dtype), reference=reference)
                assert state.p.dtype == dtype
                assert np.all(np.isfinite(vector_of(state)))
                position = np.asarray(path.position)
                # A step at full speed ends beyond a stop before that acts.
                bound = margin + 0.5 * dt * np.asarray(links.max_speed)
                assert np.all(np.maximum(low - position, position - high) < bound), dt
            assert np.all(np.abs(state.joints.position - settled) < margin), dt


def test_a_motor_keeps_to_its_speed(shipped):
    links, home = shipped.params.links, efforts.home(shipped.params.links)
    state = make_state(shipped, theta=home.position.at[0].set(1.0))
    reference = replace(home, position=home.position.at[0].set(5.0))
    advance = quickly(partial(fly, shipped, shipped.params, dt=0.01, steps=400))
    _, path = advance(replace(state, nu=jnp.zeros(6)), reference=reference)
    # Nothing drives faster than asked, but for a servo's error under load.
    assert np.max(np.abs(path.velocity[:, 0])) < 1.05 * links.max_speed[0]
    assert np.max(path.velocity[100:300, 0]) > 0.95 * links.max_speed[0]


def test_a_robot_without_arm_flies_in_a_fleet_with_arms_as_it_does_alone(shipped):
    heavy = library.load_vehicle("bluerov2_heavy")
    both = [(shipped.config, "wu2018"), (heavy, "wu2018")]
    engine, bodies = mjx_engine.build_engine(
        [mjcf.to_spec(c, name, shapes=False, absent_links=shipped.config) for c, name in both]
    )
    stacked = params.stack_vehicles([params.build_vehicle(c, name, 16.0) for c, name in both])
    mixed, body = (jax.tree.map(lambda leaf: leaf[1], tree) for tree in (stacked, bodies))
    state = replace(make_state(shipped), joints=efforts.home(mixed.links))
    alone_engine, alone_body = mjx_engine.build_engine(
        [mjcf.to_spec(heavy, "wu2018", shapes=False)]
    )
    alone = params.build_vehicle(heavy, "wu2018", 16.0)

    @quickly
    def in_fleet(D_q):
        vehicle = replace(mixed, D_q=D_q)
        return fly(shipped, vehicle, state, 0.01, 100, engine=engine, body=body)[0]

    @quickly
    def by_itself(D_q):
        vehicle = replace(alone, D_q=D_q)
        rigid = replace(state, joints=None, force_before=jnp.zeros(6))
        return fly(shipped, vehicle, rigid, 0.01, 100, engine=alone_engine, body=alone_body)[0]

    # Links take a third iteration of Newton's method, which finds the rest of quadratic damping.
    for factor, tolerance in ((0.0, 1e-10), (1.0, 1e-6)):
        end, rigid = in_fleet(factor * mixed.D_q), by_itself(factor * alone.D_q)
        for name in ("p", "q", "nu"):
            np.testing.assert_allclose(
                getattr(end, name), getattr(rigid, name), rtol=10 * tolerance, atol=tolerance
            )
