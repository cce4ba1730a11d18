"""Fossen's equation of motion in NED and FRD, written from his matrices in plain numpy.

It shares nothing with the simulator but the vehicle file: other frames, other formulas (Coriolis
by matrices, rotation by the textbook's R(q), flow gradients by complex steps), other integrator.
"""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from angler_mjx.robot.vehicles.config import VehicleConfig

RHO, G = 1000.0, 9.81
FLIP = np.diag([1.0, -1.0, -1.0])
FLIP6 = np.kron(np.eye(2), FLIP)

type Flow = Callable[[np.ndarray], np.ndarray]


def S(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def m2c(M, nu):
    """Coriolis matrix of a symmetric inertia matrix (Fossen 2021, section 3.3.1 and 6.3.1)."""
    momentum = M @ nu
    C = np.zeros((6, 6))
    C[:3, 3:] = C[3:, :3] = -S(momentum[:3])
    C[3:, 3:] = -S(momentum[3:])
    return C


def rotation(q):
    """Body to NED: I + 2 eta S(eps) + 2 S(eps)^2 (Fossen 2021, section 2.2.2)."""
    eps = S(q[1:])
    return np.eye(3) + 2 * q[0] * eps + 2 * eps @ eps


def quaternion_rate(q, omega):
    eta, eps = q[0], q[1:]
    return 0.5 * np.concatenate([[-eps @ omega], (eta * np.eye(3) + S(eps)) @ omega])


def uniform_and_vortex(uniform, centre, circulation, core) -> Flow:
    """Velocity in NED of a uniform current and one Lamb-Oseen vortex, clockwise from above."""

    def flow(p):
        north, east = p[0] - centre[0], p[1] - centre[1]
        square = north * north + east * east
        turn = circulation / (2 * np.pi * square) * (1 - np.exp(-square / core**2))
        return np.array(
            [uniform[0] - turn * east, uniform[1] + turn * north, uniform[2] + 0 * turn]
        )

    return flow


def gradient(flow: Flow, p):
    """Jacobian [i, j] = dv_i / dx_j by complex steps: exact to rounding."""
    h = 1e-30
    return flow(p[:, None] + 1j * h * np.eye(3)).imag / h


class Vehicle:
    """One vehicle in a steady flow; ``state`` is [p_ned, q, nu_frd, thrusts]."""

    def __init__(self, config: VehicleConfig, name: str, flow: Flow):
        chosen = config.find_set(name)
        m = chosen.rigid_body.mass_kg
        I = FLIP @ np.array(chosen.rigid_body.inertia_kgm2) @ FLIP  # noqa: E741
        self.M_RB = np.block([[m * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), I]])
        self.M_A = FLIP6 @ np.array(chosen.added_mass.coefficients) @ FLIP6
        self.D, self.D_n = (
            FLIP6 @ (np.diag(table) if np.ndim(table) == 1 else np.array(table)) @ FLIP6
            for table in (chosen.damping.linear, chosen.damping.quadratic)
        )
        self.products = [
            (row, *pair, value * np.prod(np.diag(FLIP6)[[row, *pair]]))
            for name, value in chosen.damping.products.items()
            for row, pair in [("XYZKMN".index(name[0]), ["uvwpqr".index(x) for x in name[2:]])]
        ]
        self.r_b = FLIP @ np.array(chosen.buoyancy.center_of_buoyancy_m)
        self.W, self.volume = m * G, chosen.buoyancy.volume_m3
        self.buoyancy = RHO * G * self.volume
        self.tau = config.rotor.lag.time_constant_s
        self.flow = flow
        center = np.array(config.base.center_of_mass_m)
        columns = []
        for thruster in config.thrusters.layout:
            arm = FLIP @ (np.array(thruster.position_m) - center)
            force = FLIP @ np.array(thruster.direction)
            columns.append(np.concatenate([force, S(arm) @ force]))
        self.T = np.array(columns).T

    def g(self, R):
        """Restoring forces on the left-hand side, centre of gravity in the origin."""
        weight, lift = R.T @ [0, 0, self.W], R.T @ [0, 0, -self.buoyancy]
        return -np.concatenate([weight + lift, S(self.r_b) @ lift])

    def lift(self, nu_r):
        """Wrench of derivatives by products of velocities."""
        wrench = np.zeros(6)
        for row, j, k, value in self.products:
            wrench[row] += value * nu_r[j] * nu_r[k]
        return wrench

    def acceleration(self, p, q, nu, thrust):
        R = rotation(q)
        v_c = self.flow(p)
        Dv_c = gradient(self.flow, p) @ v_c
        nu_c = np.concatenate([R.T @ v_c, np.zeros(3)])
        nu_c_dot = np.concatenate([R.T @ Dv_c - S(nu[3:]) @ R.T @ v_c, np.zeros(3)])
        pressure = np.concatenate([RHO * self.volume * R.T @ Dv_c, np.zeros(3)])
        nu_r = nu - nu_c
        right = (
            self.T @ thrust
            + pressure
            + self.M_A @ nu_c_dot
            - m2c(self.M_RB, nu) @ nu
            - m2c(self.M_A, nu_r) @ nu_r
            - (self.D + self.D_n @ np.diag(np.abs(nu_r))) @ nu_r
            + self.lift(nu_r)
            - self.g(R)
        )
        return np.linalg.solve(self.M_RB + self.M_A, right)

    def rate(self, state, command):
        p, q, nu, thrust = np.split(state, [3, 7, 13])
        return np.concatenate(
            [
                rotation(q) @ nu[:3],
                quaternion_rate(q, nu[3:]),
                self.acceleration(p, q, nu, thrust),
                (command - thrust) / self.tau,
            ]
        )

    def solve(self, state, commands, hold_s, rtol=1e-10):
        """States after each command, each held for ``hold_s``, by DOP853."""
        out = []
        for command in commands:
            solution = solve_ivp(
                lambda _, y, c=command: self.rate(y, c),
                (0, hold_s),
                state,
                method="DOP853",
                rtol=rtol,
                atol=rtol / 100,
            )
            state = solution.y[:, -1]
            state[3:7] /= np.linalg.norm(state[3:7])
            out.append(state)
        return np.array(out)
