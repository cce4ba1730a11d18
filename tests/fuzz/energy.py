"""A balance of energy of robots that fly: what they gain is what thrusters and water gave them.

From the equation of motion (`angler_kernels.rigid_body`), with E = 1/2 nu^T (M_RB + M_A) nu + m g z
- rho g V S(z_cb), where S' is the share of the hull under water, and because C_RB and C_A do no
work on nu and on nu_r, along any motion

    dE/dt = nu . B f                                       thrusters
          - nu . D(nu_r) nu_r                              damping
          - v_c . (omega x (M_A nu_r)_linear)              C_A(nu_r) nu_r, where the water moves
          + nu . M_A [Dv_c/Dt - omega x v_c; 0]            added mass in accelerated water
          + rho V s(z_cb) v . Dv_c/Dt                      Froude-Krylov force

in F, with nu_r = nu - [v_c; 0]. All of the right side follows from recorded states, signals and the
field of the current, so that E(t) - E(0) must be its integral: no more, and no less. Only numbers
of vehicles and the knots and vortices of currents are taken from the simulator; the thrusts behind
their rotors' lag and Dv_c/Dt (by differences along the flow) are worked out here, in float64.

Between samples the integral is known up to how much its parts vary: for powers that go from P to P'
in a step the trapezoid is off by at most dt/2 |P' - P|, and the mean thrust, which is exact, times
the mean velocity by at most dt/4 (range of f) |change of velocity|. The sum of these is the bound.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import expm

NUMBERS = (
    *("mass_kg", "inertia_kgm2", "M_A", "D_l", "D_q", "volume_m3", "p_cb_m", "hull_height_m"),
    *("B", "thrust_n", "thruster_health"),
)
"""Of a vehicle."""
PARTS = 1e-3
"""Share of all the energy that was turned over that float32 and the scheme's own error (second
order, as the trapezoid is) may take."""
MOST_DT_S, UNRESOLVED = 0.02, 4.0
"""Control period up to which samples show the motion that the bound is made of, and how many times
the bound is allowed above it: at 0.05 s a hull that turns at 10 rad/s, or crosses a core of 1 m,
does more between two samples than they tell. Of 1,920 such worlds the worst balance was off by 2.6
times the bound; the same scenarios were at 0.80 and 0.86 of it at 0.02 s, one at 0.53 at 0.01 s."""
LEAST_J = 0.1
"""And this: in a hull that turns slowly, rounding of positions times its weight in water."""


def rotate_to_body(q, v):
    """Vectors of W in F; q wxyz."""
    w, u = q[..., :1], -q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def up_in_body(q):
    """The world's z axis in F."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)


class Field:
    """The water of worlds, in float64: [W, R, 3] at positions [W, R, 3] and times []."""

    def __init__(self, current: Any) -> None:
        self._parts = []
        for one in current:
            named = vars(one)
            arrays = {key: np.asarray(x, np.float64) for key, x in named.items()}
            self._parts.append((type(one).__name__, arrays))

    def velocity(self, p, t):
        """Of the water."""
        v = np.zeros_like(p)
        for kind, a in self._parts:
            v = v + getattr(self, f"_{kind}")(a, p, t)
        return v

    def rate(self, p, t, h=1e-3):
        """Dv/Dt: the difference of what a particle of water has a moment later and earlier."""
        if not self._parts:
            return np.zeros_like(p)
        v = self.velocity(p, t)
        return (self.velocity(p + h * v, t + h) - self.velocity(p - h * v, t - h)) / (2 * h)

    @staticmethod
    def _Uniform(a, p, t):
        return np.broadcast_to(a["velocity_mps"][:, None], p.shape)

    @staticmethod
    def _GaussMarkov(a, p, t):
        knots = a["knots_mps"]
        phase = np.clip(t / a["knot_dt_s"], 0, knots.shape[1] - 1)
        k = np.clip(np.floor(phase).astype(int), 0, knots.shape[1] - 2)
        s = (phase - k)[:, None]
        row = np.arange(len(knots))
        v = knots[row, k] + s * s * (3 - 2 * s) * (knots[row, k + 1] - knots[row, k])
        return np.broadcast_to(v[:, None], p.shape)

    @staticmethod
    def _Vortices(a, p, t):
        away = p[:, :, None, :2] - a["centre_m"][:, None]
        square = np.maximum(np.sum(away**2, axis=-1), 1e-12)
        core = a["core_m"][:, None]
        turn = a["circulation_m2ps"][:, None] / (2 * np.pi * square) * -np.expm1(-square / core**2)
        x, y = away[..., 0], away[..., 1]
        return np.stack([-(turn * y).sum(-1), (turn * x).sum(-1), np.zeros(p.shape[:2])], axis=-1)


class Rotors:
    """Thrusts behind their lag, [W, R, n_thruster]: exact for signals held over a step."""

    def __init__(self, vehicle: Any, dt: float) -> None:
        if vehicle.rotor is None:
            tau = np.asarray(vehicle.tau_s, np.float64)[..., None]
            a, b = -1.0 / tau[..., None], (1.0 / tau)[..., None]
            lead = tau.shape[:-1]
            a, b = np.broadcast_to(a, (*lead, 1, 1)), np.broadcast_to(b, (*lead, 1, 1))
        else:
            # f''' + a2 f'' + a1 f' + a0 f = b2 u'' + b1 u' + b0 u, in companion form.
            b2, b1, b0 = vehicle.rotor.numerator
            a2, a1, a0 = vehicle.rotor.denominator
            a = np.array([[-a2, 1.0, 0.0], [-a1, 0.0, 1.0], [-a0, 0.0, 0.0]])
            b = np.array([[b2], [b1], [b0]])
        n = a.shape[-1]
        # The states, the signal that is held, and the integral of the thrust.
        whole = np.zeros((*a.shape[:-2], n + 2, n + 2))
        whole[..., :n, :n], whole[..., :n, n : n + 1] = a, b
        whole[..., n + 1, 0] = 1.0
        self._step, self._n, self._dt = expm(whole * dt), n, dt
        self._x = None

    def advance(self, asked):
        """Thrusts before and after a step, and their mean; they settle at ``asked``."""
        if self._x is None:
            self._x = np.zeros((*asked.shape, self._n))
        whole = np.concatenate([self._x, asked[..., None], np.zeros((*asked.shape, 1))], axis=-1)
        step = self._step if self._step.ndim == 2 else self._step[:, :, None]
        after = np.squeeze(step @ whole[..., None], -1)
        before, self._x = self._x[..., 0], after[..., : self._n]
        return before, self._x[..., 0], after[..., -1] / self._dt


@dataclass(kw_only=True)
class Books:
    """Energy of all robots [W, R] of a tile, step by step."""

    vehicle: Any
    """`VehicleParams`, [W, R] leading."""
    current: Any
    density: float
    gravity: float
    dt: float
    """Control period, s, at which samples come."""
    worst: np.ndarray = field(init=False)
    """[W, R] largest difference between energy and work so far, in parts of what is allowed."""
    worst_j: np.ndarray = field(init=False)
    """[W, R] that difference, J."""
    turned_over: np.ndarray = field(init=False)
    """[W, R] sum of all energy that went in or out, J."""

    def __post_init__(self) -> None:
        self._a = {name: np.asarray(getattr(self.vehicle, name), np.float64) for name in NUMBERS}
        a = self._a
        inertia = np.array(a["M_A"])
        inertia[..., :3, :3] += a["mass_kg"][..., None, None] * np.eye(3)
        inertia[..., 3:, 3:] += a["inertia_kgm2"]
        self._M = inertia
        lead = a["mass_kg"].shape
        self.worst, self.worst_j = np.zeros(lead), np.zeros(lead)
        self.turned_over = np.zeros(lead)
        self._field, self._rotors = Field(self.current), Rotors(self.vehicle, self.dt)
        self._before: Any = None
        self._open = np.ones(lead, bool)
        self._work, self._slack = np.zeros(lead), np.zeros(lead)
        self._first: Any = None

    def _energy(self, p, q, nu):
        a = self._a
        kinetic = 0.5 * np.einsum("wri,wrij,wrj->wr", nu, self._M, nu)
        z = p[..., 2] + np.sum(up_in_body(q) * a["p_cb_m"], axis=-1)
        h = a["hull_height_m"]
        faded = 0.5 * z - z * z / (2 * h) - h / 8
        depth = np.where(z < -h / 2, z, np.where(z > h / 2, 0.0, faded))
        lift = self.density * self.gravity * a["volume_m3"] * depth
        return kinetic + self.gravity * a["mass_kg"] * p[..., 2] - lift

    def _water(self, p, q, nu, t):
        """Power of the water, [5, W, R]: by its parts, so that they cannot hide each other."""
        a = self._a
        v, omega = nu[..., :3], nu[..., 3:]
        v_c = rotate_to_body(q, self._field.velocity(p, t))
        rate = rotate_to_body(q, self._field.rate(p, t))
        nu_r = np.concatenate([v - v_c, omega], axis=-1)
        momentum = np.einsum("wrij,wrj->wri", a["M_A"], nu_r)[..., :3]
        gained = np.concatenate([rate - np.cross(omega, v_c), np.zeros_like(omega)], axis=-1)
        z = p[..., 2] + np.sum(up_in_body(q) * a["p_cb_m"], axis=-1)
        share = np.clip(0.5 - z / a["hull_height_m"], 0.0, 1.0)
        return np.stack(
            [
                -np.sum(nu * (a["D_l"] + a["D_q"] * np.abs(nu_r)) * nu_r, axis=-1),
                -np.sum(v_c * np.cross(omega, momentum), axis=-1),
                np.einsum("wri,wrij,wrj->wr", nu, a["M_A"], gained),
                self.density * a["volume_m3"] * share * np.sum(v * rate, axis=-1),
            ]
        )

    def _asked(self, pwm):
        """Thrusts that signals settle at: between the lines of the table."""
        place = np.clip((pwm - 1100.0) / 4.0, 0, 200)
        k = np.minimum(place.astype(int), 199)
        low = np.take_along_axis(self._a["thrust_n"], k, axis=-1)
        high = np.take_along_axis(self._a["thrust_n"], k + 1, axis=-1)
        return (low + (place - k) * (high - low)) * self._a["thruster_health"]

    def add(self, p, q, nu, pwm, alive, t) -> None:
        """One sample of all robots; ``alive`` bool [W, R] of those that still fly."""
        p, q, nu = (np.asarray(x, np.float64) for x in (p, q, nu))
        energy, power = self._energy(p, q, nu), self._water(p, q, nu, t)
        along = np.einsum("wrij,wri->wrj", self._a["B"], nu)
        if self._before is None:
            self._first = energy
        else:
            power_0, along_0, (f_0, f_1, mean, asked) = self._before
            self._open &= alive
            given = self.dt * 0.5 * (power + power_0)
            pushed = self.dt * mean * 0.5 * (along + along_0)
            reach = np.stack([f_0, f_1, asked])
            range_n = reach.max(axis=0) - reach.min(axis=0)
            loose = 0.25 * self.dt * np.sum(range_n * np.abs(along - along_0), axis=-1)
            loose += 0.5 * self.dt * np.sum(np.abs(power - power_0), axis=0)
            self._work += np.where(self._open, given.sum(axis=0) + pushed.sum(axis=-1), 0.0)
            self._slack += np.where(self._open, loose, 0.0)
            turned = np.abs(given).sum(axis=0) + np.abs(pushed).sum(axis=-1)
            self.turned_over += np.where(self._open, turned, 0.0)
            off = np.where(self._open, np.abs(energy - self._first - self._work), 0.0)
            allowed = self._slack + PARTS * self.turned_over + LEAST_J
            parts = np.where(np.isfinite(off), off / allowed, np.inf)
            self.worst_j = np.where(parts > self.worst, off, self.worst_j)
            self.worst = np.maximum(self.worst, parts)
        asked = self._asked(np.nan_to_num(np.asarray(pwm, np.float64)))
        self._before = power, along, (*self._rotors.advance(asked), asked)
