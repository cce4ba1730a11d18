"""The control laws as their docstrings and sources state them, one robot, in plain numpy, float64.

Rotations are scipy's, Coriolis terms those of the textbook's matrices. ``v`` is a vehicle, ``g``
gains, ``at`` an estimate; what a law remembers comes and goes as a dict.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from ....sim.physics.textbook import S, m2c

RHO, G, DT = 1025.0, 9.80665, 0.05

# Motors 1 to 8 of vectored_6dof: roll, pitch, yaw, throttle, forward, lateral, in FRD.
HEAVY = np.array(
    [
        [0, 0, 1, 0, -1, 1],
        [0, 0, -1, 0, -1, -1],
        [0, 0, -1, 0, 1, 1],
        [0, 0, 1, 0, 1, -1],
        [1, -1, 0, -1, 0, 0],
        [-1, -1, 0, -1, 0, 0],
        [1, 1, 0, -1, 0, 0],
        [-1, 1, 0, -1, 0, 0],
    ]
)
# Two vertical thrusters abeam: right and left, no pitch; the last two places are padding.
SIX = np.vstack([HEAVY[:4], [[1, 0, 0, -1, 0, 0], [-1, 0, 0, -1, 0, 0]], np.zeros((2, 6))])


def in_flu(rows):
    """The same factors [n, 6] as forward, left, up, roll, pitch, yaw: three signs turn."""
    roll, pitch, yaw, throttle, forward, lateral = rows.T
    return np.stack([forward, -lateral, throttle, roll, -pitch, -yaw])


def rotation(q):
    return Rotation.from_quat(np.roll(q, -1))


def heading_of(q):
    return rotation(q).as_euler("ZYX")[0]


def into_body(at, vector):
    return rotation(at.q).inv().apply(vector)


def up(at):
    return into_body(at, [0.0, 0.0, 1.0])


def wrapped(angle):
    return np.angle(np.exp(1j * angle))


def axes(linear, angular):
    return np.repeat([linear, angular], 3)


def limited(vector, most):
    length = np.linalg.norm(vector)
    return vector * most / length if length > most else vector


def turn_to(at, yaw):
    """2 sin(angle / 2) along the axis of the rotation to level with a heading, in F."""
    left = rotation(at.q).inv() * Rotation.from_euler("z", yaw)
    return 2.0 * left.as_quat(canonical=True)[:3]


def fastest(v):
    """90 % of the slowest terminal speed of those there are."""
    return 0.9 * min(speed for speed in v.terminal_speed_mps if speed > 0)


def bow(v, at, velocity, asked):
    """Without sway it turns by 0.5 rad at a time to where it goes, if that is over 5 cm/s."""
    if v.terminal_speed_mps[1] > 0 or np.hypot(*velocity[:2]) <= 0.05:
        return asked
    now = heading_of(at.q)
    return now + np.clip(wrapped(np.arctan2(velocity[1], velocity[0]) - now), -0.5, 0.5)


def inertia(v):
    dry = np.zeros((6, 6))
    dry[:3, :3], dry[3:, 3:] = v.mass_kg * np.eye(3), v.inertia_kgm2
    return dry


def damping(v, nu):
    return v.D_l * nu + v.D_q * np.abs(nu) * nu


def motion(v, at, acceleration, flow, damped):
    """All terms of Fossen's equation in a steady flow but weight and buoyancy."""
    v_c = into_body(at, flow)
    nu_c = np.append(v_c, np.zeros(3))
    nu_c_dot = np.append(-S(at.nu[3:]) @ v_c, np.zeros(3))
    nu_r = at.nu - nu_c
    return (
        (inertia(v) + v.M_A) @ acceleration
        + m2c(inertia(v), at.nu) @ at.nu
        + m2c(v.M_A, nu_r) @ nu_r
        + damping(v, damped - nu_c)
        - v.M_A @ nu_c_dot
    )


def net_weight(v, at):
    return np.append((v.mass_kg - RHO * v.volume_m3) * G * up(at), np.zeros(3))


def restoring(v, at):
    lift = RHO * v.volume_m3 * G * up(at)
    return net_weight(v, at) - np.append(np.zeros(3), np.cross(v.p_cb_m, lift))


def pose(g, v, cruise, at, target):
    velocity = target.velocity_mps + g.position_per_s * (target.position_m - at.p)
    velocity = limited(velocity, min(1.5 * cruise, fastest(v)))
    yaw = bow(v, at, velocity, target.yaw_rad)
    return np.append(into_body(at, velocity), g.attitude_per_s * turn_to(at, yaw))


def pid_pose(g, v, carry, at, target):
    error = target.position_m - at.p
    slip = target.velocity_mps - rotation(at.q).apply(at.nu[:3])
    z = carry.integral_mps
    wanted = target.velocity_mps + g.position_per_s * error + z + g.position_derivative * slip
    if np.linalg.norm(wanted) <= fastest(v):
        z = z + DT * g.position_integral_per_s2 * error
    z = np.clip(z, -g.integral_limit_mps, g.integral_limit_mps)
    velocity = limited(wanted, fastest(v))
    yaw = bow(v, at, velocity, target.yaw_rad)
    turn = g.attitude_per_s * turn_to(at, yaw)
    return {"integral_mps": z}, np.append(into_body(at, velocity), turn)


def velocity(g, v, carry, at, wanted):
    e, most = wanted - at.nu, g.integral_limit_mps2
    z = np.clip(carry.integral + g.integral_per_s2 * DT * e, -most, most)
    acceleration = axes(g.velocity_per_s, g.rate_per_s) * e + z
    tau = (
        (inertia(v) + v.M_A) @ acceleration
        + damping(v, wanted)
        + m2c(v.M_A, wanted) @ wanted
        + net_weight(v, at)
    )
    return {"integral": z}, tau


def pid_velocity(g, v, carry, at, wanted, realised):
    e, M = wanted - at.nu, inertia(v) + v.M_A
    slope = (at.nu - carry.nu) / DT
    slope = carry.acceleration + DT / (DT + g.derivative_filter_s) * (slope - carry.acceleration)
    excess = g.back_calculation_per_s * (carry.demand - realised) / np.diag(M)
    growth = axes(g.velocity_integral_per_s2, g.rate_integral_per_s2) * e - excess
    most = g.integral_limit_mps2
    z = np.clip(carry.integral + DT * growth, -most, most)
    wanted = axes(g.velocity_per_s, g.rate_per_s) * e + z
    wanted -= axes(g.velocity_derivative, g.rate_derivative) * slope
    tau = M @ wanted + net_weight(v, at)
    return {"integral": z, "nu": at.nu, "acceleration": slope, "demand": tau}, tau


def reference(g, v, at, target):
    """Velocity [6] that closes the errors, and acceleration [6] of the target, in F."""
    velocity = target.velocity_mps + g.position_per_s * (target.position_m - at.p)
    velocity = limited(velocity, fastest(v))
    yaw = bow(v, at, velocity, target.yaw_rad)
    turn = target.yaw_rate_radps * up(at) + g.attitude_per_s * turn_to(at, yaw)
    linear = into_body(at, target.acceleration_mps2) - np.cross(at.nu[3:], at.nu[:3])
    forward = np.append(linear, target.yaw_acceleration_radps2 * up(at))
    return np.append(into_body(at, velocity), turn), forward


def computed_torque(g, v, carry, at, target, flow):
    wanted, forward = reference(g, v, at, target)
    e, most = wanted - at.nu, g.integral_limit_mps2
    z = np.clip(carry.integral + DT * g.integral_per_s2 * e, -most, most)
    acceleration = forward + axes(g.velocity_per_s, g.rate_per_s) * e + z
    return {"integral": z}, motion(v, at, acceleration, flow, at.nu) + restoring(v, at)


def tracking(g, v, carry, at, target, flow, realised):
    wanted, forward = reference(g, v, at, target)
    e, most = wanted - at.nu, g.integral_limit_mps2
    excess = (carry.demand - realised) / np.diag(inertia(v) + v.M_A)
    growth = g.integral_per_s2 * e - g.back_calculation_per_s * excess
    z = np.clip(carry.integral + DT * growth, -most, most)
    acceleration = forward + axes(g.velocity_per_s, g.rate_per_s) * e + z
    tau = motion(v, at, acceleration, flow, wanted) + net_weight(v, at)
    return {"integral": z, "demand": tau}, tau


def ismc(g, v, carry, at, wanted, flow):
    e, K = wanted - at.nu, axes(g.velocity_per_s, g.rate_per_s)
    layer, rho = axes(g.layer_mps, g.layer_radps), axes(g.sliding_mps2, g.sliding_radps2)
    before = -e if carry.fresh else carry.integral
    grown = before + DT * K * e
    # Where s would pass two layers, and grow, the integral is kept.
    kept = np.abs(e + grown) > np.maximum(2.0 * layer, np.abs(e + before))
    z = np.clip(np.where(kept, before, grown), -2.0 * layer, 2.0 * layer)
    acceleration = K * e + rho * np.tanh((e + z) / layer)
    tau = motion(v, at, acceleration, flow, wanted) + restoring(v, at)
    return {"integral": z, "fresh": False}, tau


def aitsm(g, v, carry, at, wanted, flow):
    e = wanted - at.nu
    # |e|^r sgn(e), linear below 3 cm/s and 0.03 rad/s.
    power = e * np.hypot(e, 0.03) ** (g.exponent - 1.0)
    grown = carry.z + DT * power
    before = np.abs(e + g.terminal * carry.z)
    kept = np.abs(e + g.terminal * grown) > np.maximum(g.surface_limit, before)
    z = np.where(kept, carry.z, grown)
    s = e + g.terminal * z
    rate = g.adaptation * np.abs(s) - g.leak_per_s * (carry.k_1 - g.sliding_least)
    k_1 = np.clip(carry.k_1 + DT * rate, g.sliding_least, g.sliding_most)
    sliding = k_1 * np.abs(s) ** 0.5 * np.clip(s / g.layer, -1.0, 1.0)
    acceleration = g.terminal * power + sliding + g.reaching_per_s * s
    tau = motion(v, at, acceleration, flow, wanted) + restoring(v, at)
    return {"z": z, "k_1": k_1}, tau


def los(g, v, carry, at, path):
    """Segments up to the last time; the bow turns to the course, but holds at the end."""
    n = int(np.argmax(path.time_s >= path.time_s[-1]))  # the last segment that is one ends here
    lengths = np.linalg.norm(np.diff(path.position_m, axis=0), axis=1)

    def on(k):
        tangent = (path.position_m[k + 1] - path.position_m[k]) / lengths[k]
        return tangent, (at.p - path.position_m[k]) @ tangent

    k = int(carry.segment)
    if on(k)[1] > lengths[k] - g.switch_radius_m and k + 1 < n:
        k += 1
    tangent, along = on(k)
    U = min(lengths[k] / (path.time_s[k + 1] - path.time_s[k]), fastest(v))
    c = at.p - path.position_m[k] - along * tangent
    y = carry.integral - (carry.integral @ tangent) * tangent
    pull, D = c + g.integral_per_s * y, g.lookahead_m
    z = y + DT * D * c / (pull @ pull + D * D)
    aim = D * tangent - pull
    go = U * aim / np.linalg.norm(aim)
    arriving = k + 1 == n and g.position_per_s * (lengths[k] - along) < U
    if arriving:
        go = limited(g.position_per_s * (path.position_m[n] - at.p), max(U, 0.1))
    holds = arriving and v.terminal_speed_mps[1] > 0
    rate = 0.0
    if np.hypot(*go[:2]) > 0.05 and not holds:
        off = wrapped(np.arctan2(go[1], go[0]) - carry.yaw_rad)
        rate = np.clip(off / DT, -g.yaw_rate_radps, g.yaw_rate_radps)
    yaw = wrapped(carry.yaw_rad + rate * DT)
    turn = rate * up(at) + g.attitude_per_s * turn_to(at, yaw)
    z = np.clip(z, -g.integral_limit_m, g.integral_limit_m)
    return {"segment": k, "integral": z, "yaw_rad": yaw}, np.append(into_body(at, go), turn)
