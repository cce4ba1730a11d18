"""ArduSub's loops and mixer by the words of its surrogate, number by number, in plain Python."""

import math
from types import SimpleNamespace

import numpy as np

from .equations import DT, HEAVY, SIX, G, heading_of, in_flu, rotation, turn_to, up, wrapped

CDEG = math.radians(0.01)


def square_root(error, p, most, dt=DT):
    """P near zero; beyond, the speed from which ``most`` still brakes in time; not past the end."""
    knee = most / p**2
    size = abs(error)
    rate = p * size if size <= knee else math.sqrt(2.0 * most * (size - knee / 2.0))
    return math.copysign(min(rate, size / dt), error)


def low_pass(old, new, hz):
    """dt / (dt + RC), with RC of the cut-off."""
    return old + (DT / (DT + 1.0 / (2.0 * math.pi * hz)) if hz > 0 else 1.0) * (new - old)


def pid(p, carry, target, measured, limited):
    """P e + I int e + D e'; each with its filter; what was cut lets the integral only shrink."""
    target = low_pass(carry.target, target, p.FLTT)
    error = low_pass(carry.error, target - measured, p.FLTE)
    slope = low_pass(carry.derivative, (error - carry.error) / DT, p.FLTD)
    integral = carry.integral + p.I * DT * error
    if limited and abs(integral) > abs(carry.integral):
        integral = carry.integral
    integral = min(max(integral, -p.IMAX), p.IMAX)
    after = {"target": target, "error": error, "derivative": slope, "integral": integral}
    return after, p.P * error + integral + p.D * slope


def each(carry, i):
    return SimpleNamespace(**{name: value[i] for name, value in vars(carry).items()})


def together(rows):
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def plane(g, carry, at, speed, target):
    """Demand forward and left, as shares of the lean that ANGLE_MAX allows."""
    error = target.position_m[:2] - at.p[:2]
    distance = np.linalg.norm(error)
    rate = min(square_root(distance, g.PSC_POSXY_P, g.WPNAV_ACCEL / 100), g.WPNAV_SPEED / 100)
    wanted = target.velocity_mps[:2] + rate * error / distance
    p = SimpleNamespace(
        P=g.PSC_VELXY_P,
        I=g.PSC_VELXY_I,
        D=g.PSC_VELXY_D,
        IMAX=g.PSC_VELXY_IMAX / 100,
        FLTT=0.0,
        FLTE=g.PSC_VELXY_FLTE,
        FLTD=g.PSC_VELXY_FLTD,
    )
    rows = [pid(p, each(carry.plane, i), wanted[i], speed[i], carry.limited) for i in (0, 1)]
    east, north = (out for _, out in rows)
    yaw = heading_of(at.q)
    level = np.array(
        [
            math.cos(yaw) * east + math.sin(yaw) * north,
            math.cos(yaw) * north - math.sin(yaw) * east,
        ]
    )
    lean = g.ANGLE_MAX * CDEG
    size = np.linalg.norm(level)
    level *= min(1.0, G * math.tan(lean) / size)
    return together([row for row, _ in rows]), np.arctan(level / G) / lean


def depth(g, carry, at, speed, target):
    wanted = square_root(target.position_m[2] - at.p[2], g.PSC_POSZ_P, g.WPNAV_ACCEL_Z / 100)
    wanted = min(max(wanted, -g.WPNAV_SPEED_DN / 100), g.WPNAV_SPEED_UP / 100)
    slip = low_pass(
        carry.velocity_error_z, wanted + target.velocity_mps[2] - speed[2], g.PSC_VELZ_FLTE
    )
    p = SimpleNamespace(
        P=g.PSC_ACCZ_P,
        I=g.PSC_ACCZ_I,
        D=g.PSC_ACCZ_D,
        IMAX=g.PSC_ACCZ_IMAX,
        FLTT=0.0,
        FLTE=g.PSC_ACCZ_FLTE,
        FLTD=0.0,
    )
    measured = 100 * (speed[2] - carry.velocity_mps[2]) / DT
    after, out = pid(p, carry.depth, 100 * g.PSC_VELZ_P * slip, measured, carry.limited)
    return after, slip, min(max(2.0 * out / 1000.0, -1.0), 1.0)


def shaped_yaw(g, carry, wanted):
    most, slew = g.ATC_ACCEL_Y_MAX * CDEG, g.ATC_SLEW_YAW * CDEG
    rate = square_root(wrapped(wanted - carry.yaw_rad), 1.0 / g.ATC_INPUT_TC, most)
    rate = min(max(rate, -slew), slew)
    rate = carry.yaw_rate_radps + np.clip(rate - carry.yaw_rate_radps, -most * DT, most * DT)
    return wrapped(carry.yaw_rad + rate * DT), rate


def attitude(g, carry, at, yaw, yaw_rate):
    error, feed, rows = turn_to(at, yaw), yaw_rate * up(at), []
    bounds = {"RLL": ("R", 40, 720), "PIT": ("P", 40, 720), "YAW": ("Y", 10, 120)}
    for i, (axis, (letter, low, high)) in enumerate(bounds.items()):
        brake = 0.5 * getattr(g, f"ATC_ACCEL_{letter}_MAX") / 100
        brake = math.radians(min(max(brake, low), high))
        wanted = square_root(error[i], getattr(g, f"ATC_ANG_{axis}_P"), brake) + feed[i]
        names = ("P", "I", "D", "IMAX", "FLTT", "FLTE", "FLTD")
        p = SimpleNamespace(**{name: getattr(g, f"ATC_RAT_{axis}_{name}") for name in names})
        rows.append(pid(p, each(carry.rate, i), wanted, at.nu[3 + i], carry.limited))
    return together([row for row, _ in rows]), np.array([out for _, out in rows])


def mix(six, demand, coupling):
    """Outputs of the thrusters, and whether any was cut."""
    demand = np.clip(demand, -1.0, 1.0)
    factors = in_flu(SIX if six else HEAVY)
    if six:
        room = max(1.0 - coupling * abs(demand[2]), 0.0)
        out = np.append(np.clip(demand[0], -room, room), demand[1:]) @ factors
        return np.clip(out, -1.0, 1.0), np.abs(out).max() > 1.0
    groups = [demand[rows] @ factors[rows] for rows in ([2, 3, 4], [0, 1, 5])]
    most = [np.abs(group).max() for group in groups]
    out = sum(group / max(1.0, top) for group, top in zip(groups, most, strict=True))
    return out, max(most) > 1.0


def step(g, six, carry, at, target):
    speed = rotation(at.q).apply(at.nu[:3])
    in_plane, level = plane(g, carry, at, speed, target)
    in_depth, slip, throttle = depth(g, carry, at, speed, target)
    yaw, yaw_rate = shaped_yaw(g, carry, target.yaw_rad)
    in_rate, turn = attitude(g, carry, at, yaw, yaw_rate)
    out, cut = mix(six, np.concatenate([level, [throttle], turn]), g.MOT_FV_CPLNG_K)
    above, below = g.MOT_PWM_MAX - g.SERVO_TRIM, g.SERVO_TRIM - g.MOT_PWM_MIN
    after = {
        "yaw_rad": yaw,
        "yaw_rate_radps": yaw_rate,
        "velocity_mps": speed,
        "velocity_error_z": slip,
        "plane": in_plane,
        "depth": in_depth,
        "rate": in_rate,
        "limited": cut,
    }
    return after, g.SERVO_TRIM + np.where(out > 0, above, below) * out
