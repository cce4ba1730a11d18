"""A vehicle with an arm by recursive Newton and Euler, in plain numpy, from its file alone.

It shares nothing with the simulator but the vehicle file: link by link, outwards velocities and
accelerations, inwards wrenches; no Jacobians. Every body, the base too, is pushed by the water by
the rates of the momenta that it gives to it (Kirchhoff), its cylinders by five strips each.
"""

from dataclasses import dataclass, field

import numpy as np

from angler_mjx.robot.vehicles.config import VehicleConfig

RHO, G = 1000.0, 9.81
STRIPS = 5
NODES = np.polynomial.legendre.leggauss(3)


@dataclass
class Body:
    """One body: its numbers, its motion, and what must push it."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray
    volume: float
    cob: np.ndarray
    fade: float
    added: np.ndarray
    cylinders: list = field(default_factory=list)
    damping: np.ndarray = field(default_factory=lambda: np.zeros((2, 6)))


def turn(axis, angle):
    """Rotation about a unit axis, by half angles (Euler and Rodrigues)."""
    w, (x, y, z) = np.cos(angle / 2), np.sin(angle / 2) * np.asarray(axis)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def frame(rpy):
    roll, pitch, yaw = rpy
    return turn([0, 0, 1], yaw) @ turn([0, 1, 0], pitch) @ turn([1, 0, 0], roll)


def to_matrix(q):
    axis_sine = np.asarray(q[1:])
    sine = np.linalg.norm(axis_sine)
    return turn(axis_sine / sine, 2 * np.arctan2(sine, q[0]))


def carried_water(cylinders, com):
    """Added mass [6, 6] at ``com`` of cylinders, integrated along their axes (exactly)."""
    total = np.zeros((6, 6))
    for cylinder in cylinders:
        start, end = np.array(cylinder.from_m), np.array(cylinder.to_m)
        length = np.linalg.norm(end - start)
        axis = (end - start) / length
        per_metre = RHO * cylinder.added_mass * np.pi * cylinder.radius_m**2
        for node, weight in zip(*NODES, strict=True):
            point = start + 0.5 * (node + 1) * (end - start) - com
            # Velocity of the point by [v; omega]: v + omega x point; momentum across the axis.
            at = np.hstack([np.eye(3), np.cross(np.eye(3), point).T])
            across = np.eye(3) - np.outer(axis, axis)
            total += 0.5 * weight * length * per_metre * at.T @ across @ at
    return total


def base_body(config: VehicleConfig, name: str) -> Body:
    numbers = config.find_set(name)
    return Body(
        mass=numbers.rigid_body.mass_kg,
        com=np.zeros(3),
        inertia=np.array(numbers.rigid_body.inertia_kgm2),
        volume=numbers.buoyancy.volume_m3,
        cob=np.array(numbers.buoyancy.center_of_buoyancy_m),
        fade=config.hull.height_m,
        added=np.array(numbers.added_mass.coefficients),
        damping=np.array([numbers.damping.linear, numbers.damping.quadratic]),
    )


def link_body(link) -> Body:
    com, volume = np.array(link.rigid_body.center_of_mass_m), link.buoyancy.volume_m3
    further = np.zeros((6, 6)) if link.water.added_mass is None else link.water.added_mass
    return Body(
        mass=link.rigid_body.mass_kg,
        com=com,
        inertia=np.array(link.rigid_body.inertia_kgm2),
        volume=volume,
        cob=np.array(link.buoyancy.center_of_buoyancy_m),
        fade=(6 * volume / np.pi) ** (1 / 3),
        added=carried_water(link.water.cylinders, com) + further,
        cylinders=list(link.water.cylinders),
    )


def strip_drag(body, v, omega):
    """Force and moment about the centre of mass of all strips."""
    force, moment = np.zeros(3), np.zeros(3)
    for cylinder in body.cylinders:
        start, end = np.array(cylinder.from_m), np.array(cylinder.to_m)
        length = np.linalg.norm(end - start)
        axis = (end - start) / length
        for i in range(STRIPS):
            arm = start + (i + 0.5) / STRIPS * (end - start) - body.com
            at = v + np.cross(omega, arm)
            along = (at @ axis) * axis
            across = at - along
            size = 2 * cylinder.radius_m * length / STRIPS
            push = -0.5 * RHO * cylinder.normal_drag * size * np.linalg.norm(across) * across
            push -= 0.5 * RHO * cylinder.axial_drag * np.pi * size * np.linalg.norm(along) * along
            force, moment = force + push, moment + np.cross(arm, push)
    return force, moment


def pushes(body, R, z, v, omega, a, alpha, flow, flow_rate, *, wet):
    """Force and moment about the centre of mass that joints must give, along the body's axes.

    Args:
        body: numbers.
        R: body to world.
        z: height of its origin.
        v: velocity of the centre of mass.
        omega: angular velocity.
        a: acceleration of the centre of mass.
        alpha: angular acceleration.
        flow: of the water, in W.
        flow_rate: its material derivative, in W.
        wet: whether there is water.
    """
    up = R.T @ [0, 0, 1]
    force = body.mass * (a + G * up)
    moment = body.inertia @ alpha + np.cross(omega, body.inertia @ omega)
    if not wet:
        return force, moment
    flow, flow_rate = R.T @ flow, R.T @ flow_rate
    fraction = np.clip(0.5 - (z + body.cob @ up) / body.fade, 0, 1)
    displaced = RHO * body.volume * fraction
    lift = displaced * G * up
    force = force - lift - displaced * flow_rate
    moment = moment - np.cross(body.cob - body.com, lift)
    v_r = v - flow
    rate = np.concatenate([a - np.cross(omega, v) - flow_rate + np.cross(omega, flow), alpha])
    momentum, change = body.added @ np.concatenate([v_r, omega]), body.added @ rate
    force = force + change[:3] + np.cross(omega, momentum[:3])
    moment = moment + change[3:] + np.cross(omega, momentum[3:]) + np.cross(v_r, momentum[:3])
    linear, quadratic = body.damping
    nu_r = np.concatenate([v_r, omega])
    drag = -(linear + quadratic * np.abs(nu_r)) * nu_r
    drag_force, drag_moment = strip_drag(body, v_r, omega)
    return force - drag[:3] - drag_force, moment - drag[3:] - drag_moment


@dataclass
class Chain:
    """The file as a tree by names."""

    config: VehicleConfig
    set_name: str

    def __post_init__(self):
        self.base = base_body(self.config, self.set_name)
        self.links = {link.name: link for link in self.config.find_links(self.set_name)}
        self.bodies = {name: link_body(link) for name, link in self.links.items()}
        self.tables = {joint.name: joint for joint in self.config.joints}
        self.order = [joint.name for joint in self.config.find_joints()]

    def inverse(self, p, q, nu, theta, speed, nu_dot, theta_dot2, flow, flow_rate, *, wet=True):
        """Wrench [6] on the base and efforts [J] of the joints of a motion."""
        theta, speed, push = (
            dict(zip(self.order, x, strict=True)) for x in (theta, speed, theta_dot2)
        )
        R = to_matrix(q)
        v, omega = nu[:3], nu[3:]
        a, alpha = nu_dot[:3] + np.cross(omega, v), nu_dot[3:]
        efforts = {}
        water = (np.asarray(flow), np.asarray(flow_rate))

        def visit(name, R_parent, z, v, omega, a, alpha):
            """Wrench about the origin of the parent's frame, along its axes."""
            link, body = self.links[name], self.bodies[name]
            turned, offset = frame(link.rpy_rad), np.array(link.position_m)
            if link.parent == "base":
                offset = offset - self.config.base.center_of_mass_m
            joint = self.tables.get(link.joint)
            change = theta[joint.name] - joint.zero if joint else 0.0
            rate, rate2 = (speed[joint.name], push[joint.name]) if joint else (0.0, 0.0)
            axis = np.array(joint.axis) if joint else np.zeros(3)
            slides = joint is not None and joint.type == "prismatic"
            if slides:
                offset = offset + turned @ (change * axis)
            elif joint:
                turned = turned @ turn(axis, change)
            # Of the point of the parent where the origin is, then of the origin itself.
            v = turned.T @ (v + np.cross(omega, offset))
            a = turned.T @ (a + np.cross(alpha, offset) + np.cross(omega, np.cross(omega, offset)))
            omega, alpha = turned.T @ omega, turned.T @ alpha
            if slides:
                v = v + axis * rate
                a = a + axis * rate2 + 2 * np.cross(omega, axis * rate)
            else:
                alpha = alpha + axis * rate2 + np.cross(omega, axis * rate)
                omega = omega + axis * rate
            R_link, z = R_parent @ turned, z + (R_parent @ offset)[2]
            v_c = v + np.cross(omega, body.com)
            a_c = a + np.cross(alpha, body.com) + np.cross(omega, np.cross(omega, body.com))
            force, moment = pushes(body, R_link, z, v_c, omega, a_c, alpha, *water, wet=wet)
            moment = moment + np.cross(body.com, force)
            for child in self.links.values():
                if child.parent == name:
                    more = visit(child.name, R_link, z, v, omega, a, alpha)
                    force, moment = force + more[0], moment + more[1]
            if joint:
                efforts[joint.name] = axis @ (force if slides else moment)
            force, moment = turned @ force, turned @ moment
            return force, moment + np.cross(offset, force)

        force, moment = pushes(self.base, R, p[2], v, omega, a, alpha, *water, wet=wet)
        for link in self.links.values():
            if link.parent == "base":
                more = visit(link.name, R, p[2], v, omega, a, alpha)
                force, moment = force + more[0], moment + more[1]
        return np.concatenate([force, moment, [efforts[name] for name in self.order]])
