r"""Minimum time by direct transcription of the inverse dynamics: CasADi and IPOPT.

The textbook way, and the strongest rival on a plain joint goal. Unknowns are the
positions and speeds at N + 1 nodes, one acceleration for each interval, and T:

.. math::
    \min T, \quad
    q_{k+1} = q_k + h_k v_k + \tfrac{h_k^2}{2} a_k, \quad v_{k+1} = v_k + h_k a_k,

with :math:`h_k = T / N`, or given shares of T, the torque :math:`\tau(q, v, a)` within
its limits at both ends of each interval, positions and speeds within theirs at the
nodes, and rest at both ends. First and second derivatives are exact; the interior-point
method and the linear solver run with their defaults. Nothing is smoothed: the objective
is T alone.

With torque limits at the nodes alone the optimiser may exploit the instants between: on
coarse grids light joints swing to and fro from interval to interval, and the torque
between the nodes passes its limit, so T comes out too small. ``interior_points`` asks
for the limits inside the intervals as well.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from .arm import Arm, Array, Sampler, TorqueModel, piecewise_constant_acceleration

# Entries of rotations and inertias below this are round-off of trigonometry; without
# them the expressions keep the zeros of the arm's structure.
ROUND_OFF = 1e-12


@dataclass(frozen=True)
class IpoptResult:
    """Result of IPOPT.

    Attributes:
        T: Duration in [s]; nan unless solved.
        nodes: Times of the nodes as shares of T, from 0 to 1, shape (N+1,).
        success: Whether IPOPT met its tolerances.
        status: Status reported by IPOPT.
        q: Positions at the nodes, shape (N+1, n).
        v: Velocities at the nodes, shape (N+1, n).
        a: Accelerations of the intervals, shape (N, n).
        seconds: Processor time of the solve, initial guess included [s].
        build_seconds: Processor time of the set-up, once for a robot and N [s].
        iterations: Interior-point iterations.
    """

    T: float
    nodes: Array
    success: bool
    status: str
    q: Array
    v: Array
    a: Array
    seconds: float
    build_seconds: float
    iterations: int

    @property
    def motion(self) -> Sampler:
        """The motion between the nodes, exact because accelerations are constant."""
        return piecewise_constant_acceleration(self.T * self.nodes, self.q, self.v)


def rnea(arm: Arm, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    """Joint torques as an expression, by the recursive Newton-Euler algorithm.

    Written in link coordinates with three-dimensional vectors; friction and rotor
    inertia are included.

    Args:
        arm: The robot, with revolute and prismatic joints about or along any axis.
        q: Positions, n-by-1.
        v: Velocities, n-by-1.
        a: Accelerations, n-by-1.

    Returns:
        Torques, n-by-1.
    """
    model = arm.model
    count = model.njoints
    axes = [_axis(model, i) for i in range(1, count)]
    zero = ca.SX(3, 1)
    spin, spin_rate, acceleration = [zero] * count, [zero] * count, [zero] * count
    force, moment, offset = [zero] * count, [zero] * count, [zero] * count
    rotation = [ca.SX.eye(3)] * count
    # Gravity enters as an upward acceleration of the base.
    acceleration[0] = _constant(-model.gravity.linear)

    for i in range(1, count):
        k, parent = model.joints[i].idx_v, model.parents[i]
        revolute, axis = axes[i - 1]
        placement = model.jointPlacements[i]
        fixed = _constant(placement.rotation)
        offset[i] = _constant(placement.translation)
        if revolute:
            rotation[i] = fixed @ _rotation(axis, q[k])
        else:
            rotation[i] = fixed
            offset[i] = offset[i] + fixed @ (axis * q[k])
        to_link = rotation[i].T
        carried = to_link @ spin[parent]
        spin[i], spin_rate[i] = carried, to_link @ spin_rate[parent]
        acceleration[i] = to_link @ (
            acceleration[parent]
            + ca.cross(spin_rate[parent], offset[i])
            + ca.cross(spin[parent], ca.cross(spin[parent], offset[i]))
        )
        if revolute:
            spin[i] = spin[i] + axis * v[k]
            spin_rate[i] = spin_rate[i] + axis * a[k] + ca.cross(carried, axis * v[k])
        else:
            coriolis = 2 * ca.cross(carried, axis * v[k])
            acceleration[i] = acceleration[i] + axis * a[k] + coriolis
        inertia = model.inertias[i]
        mass = inertia.mass
        lever = _constant(mass * inertia.lever)
        # Inertia about the joint's origin, from that about the centre of mass.
        cross = pin.skew(inertia.lever)
        about_origin = _constant(inertia.inertia - mass * cross @ cross)
        w, dw = spin[i], spin_rate[i]
        force[i] = (
            mass * acceleration[i]
            + ca.cross(dw, lever)
            + ca.cross(w, ca.cross(w, lever))
        )
        moment[i] = (
            about_origin @ dw
            + ca.cross(w, about_origin @ w)
            + ca.cross(lever, acceleration[i])
        )

    tau = ca.SX.zeros(arm.n)
    for i in range(count - 1, 0, -1):
        k, parent = model.joints[i].idx_v, model.parents[i]
        revolute, axis = axes[i - 1]
        tau[k] = ca.dot(axis, moment[i] if revolute else force[i])
        pushed = rotation[i] @ force[i]
        force[parent] = force[parent] + pushed
        moment[parent] = (
            moment[parent] + rotation[i] @ moment[i] + ca.cross(offset[i], pushed)
        )
    return tau + ca.DM(arm.armature) * a + ca.DM(arm.damping) * v


class InverseTranscription:
    """The nonlinear program of one robot on one grid, ready for any start and goal.

    Args:
        arm: The robot.
        intervals: Number N of intervals.
        fractions: Lengths of the intervals as shares of T, shape (N,); equal if None.
        interior_points: Further instants in each interval, equally spaced, at which the
            torque limits are imposed.
        tolerance: IPOPT's ``tol``.
        max_iterations: IPOPT's ``max_iter``.
        max_seconds: IPOPT's ``max_cpu_time``.
        expand: Whether to flatten all intervals into one scalar expression graph. It
            takes seconds to set up, once, and halves the time of every solve.
        ipopt_options: Further options of IPOPT.
    """

    def __init__(
        self,
        arm: Arm,
        intervals: int,
        *,
        fractions: Array | None = None,
        interior_points: int = 0,
        tolerance: float = 1e-6,
        max_iterations: int = 1000,
        max_seconds: float = 60.0,
        expand: bool = True,
        ipopt_options: dict[str, Any] | None = None,
    ) -> None:
        started = time.process_time()
        self._arm = arm
        self._intervals = intervals
        self._instants = np.linspace(0.0, 1.0, interior_points + 2)
        equal = np.full(intervals, 1.0 / intervals)
        shares = equal if fractions is None else np.asarray(fractions, dtype=float)
        if shares.shape != (intervals,) or not np.isclose(shares.sum(), 1.0):
            raise ValueError(f"{intervals} fractions that add up to 1 are expected")
        self._nodes = np.concatenate([[0.0], np.cumsum(shares)])
        self._torque = TorqueModel(arm)
        self._scale = np.maximum(np.abs(arm.effort_lower), np.abs(arm.effort_upper))
        self._solver = ca.nlpsol(
            "minimum_time",
            "ipopt",
            self._program(),
            {
                "print_time": False,
                "expand": expand,
                "ipopt": {
                    "print_level": 0,
                    "sb": "yes",
                    "linear_solver": "mumps",
                    "hessian_approximation": "exact",
                    "tol": tolerance,
                    "max_iter": max_iterations,
                    "max_cpu_time": max_seconds,
                    **(ipopt_options or {}),
                },
            },
        )
        self.build_seconds = time.process_time() - started

    def _program(self) -> dict[str, ca.MX]:
        """Objective, unknowns and rows; torques in units of their limit."""
        n, count = self._arm.n, self._intervals
        q0, v0, q1, v1, a = (ca.SX.sym(name, n) for name in ("q", "v", "r", "w", "a"))
        h = ca.SX.sym("h")
        states = [(q0, v0)]
        for s in self._instants[1:-1]:
            states.append((q0 + s * h * v0 + 0.5 * (s * h) ** 2 * a, v0 + s * h * a))
        states.append((q1, v1))
        rows = ca.vertcat(
            q0 + h * v0 + 0.5 * h**2 * a - q1,
            v0 + h * a - v1,
            *(rnea(self._arm, q, v, a) / self._scale for q, v in states),
        )
        interval = ca.Function("interval", [q0, v0, q1, v1, a, h], [rows])
        q, v = ca.MX.sym("q", n, count + 1), ca.MX.sym("v", n, count + 1)
        accelerations = ca.MX.sym("a", n, count)
        duration = ca.MX.sym("T")
        g = interval.map(count)(
            q[:, :-1],
            v[:, :-1],
            q[:, 1:],
            v[:, 1:],
            accelerations,
            duration * ca.DM(np.diff(self._nodes)).T,
        )
        x = ca.vertcat(ca.vec(q), ca.vec(v), ca.vec(accelerations), duration)
        return {"x": x, "f": duration, "g": ca.vec(g)}

    def solve(self, q_start: Array, q_goal: Array) -> IpoptResult:
        """Find the fastest motion from rest to rest.

        Args:
            q_start: Start, shape (n,).
            q_goal: Goal, shape (n,).
        """
        arm, n, count = self._arm, self._arm.n, self._intervals
        started = time.process_time()
        guess = straight_line_guess(arm, self._torque, q_start, q_goal, self._nodes)
        q_low = np.tile(arm.position_lower, (count + 1, 1))
        q_high = np.tile(arm.position_upper, (count + 1, 1))
        v_high = np.tile(arm.velocity, (count + 1, 1))
        q_low[0] = q_high[0] = q_start
        q_low[-1] = q_high[-1] = q_goal
        v_high[0] = v_high[-1] = 0.0
        free = np.full(count * n, np.inf)
        zero = np.zeros(2 * n)
        torque_rows = len(self._instants)
        low = np.tile(arm.effort_lower / self._scale, torque_rows)
        high = np.tile(arm.effort_upper / self._scale, torque_rows)
        answer = self._solver(
            x0=np.concatenate([part.ravel() for part in guess[:3]] + [[guess[3]]]),
            lbx=np.concatenate([q_low.ravel(), -v_high.ravel(), -free, [1e-3]]),
            ubx=np.concatenate([q_high.ravel(), v_high.ravel(), free, [np.inf]]),
            lbg=np.tile(np.concatenate([zero, low]), count),
            ubg=np.tile(np.concatenate([zero, high]), count),
        )
        seconds = time.process_time() - started
        stats = self._solver.stats()
        x = np.asarray(answer["x"]).ravel()
        states = (count + 1) * n
        return IpoptResult(
            T=float(x[-1]) if stats["success"] else float("nan"),
            nodes=self._nodes,
            success=bool(stats["success"]),
            status=str(stats["return_status"]),
            q=x[:states].reshape(count + 1, n),
            v=x[states : 2 * states].reshape(count + 1, n),
            a=x[2 * states : -1].reshape(count, n),
            seconds=seconds,
            build_seconds=self.build_seconds,
            iterations=int(stats["iter_count"]),
        )


def straight_line_guess(
    arm: Arm, torque: TorqueModel, q_start: Array, q_goal: Array, nodes: Array
) -> tuple[Array, Array, Array, float]:
    """Quintic along the straight joint line, slow enough for the limits.

    T is the smallest that keeps speeds and torques within their limits at the nodes;
    where the motors cannot even hold the arm, the torque limits are ignored.

    Args:
        arm: The robot.
        torque: Its torques.
        q_start: Start, shape (n,).
        q_goal: Goal, shape (n,).
        nodes: Times of the nodes as shares of T, from 0 to 1, shape (N+1,).

    Returns:
        q and v at the nodes, a in the intervals, T.
    """
    middles = 0.5 * (nodes[1:] + nodes[:-1])
    step = q_goal - q_start

    def profile(s: Array) -> tuple[Array, Array, Array]:
        return (
            q_start + np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, step),
            np.outer(30 * s**2 * (1 - s) ** 2, step),
            np.outer(60 * s * (1 - s) * (1 - 2 * s), step),
        )

    q, dq, ddq = profile(nodes)
    T = float(np.max(np.abs(dq) / arm.velocity))
    zero = np.zeros_like(q)
    holding = torque(q, zero, zero)
    inertial = torque(q, dq, ddq) - holding - arm.damping * dq
    inside = (holding > arm.effort_lower) & (holding < arm.effort_upper)

    def admissible(duration: float) -> bool:
        tau = holding + arm.damping * dq / duration + inertial / duration**2
        return bool(
            np.all((tau <= arm.effort_upper) & (tau >= arm.effort_lower) | ~inside)
        )

    T = max(T, 1e-2)
    for _ in range(60):
        if admissible(T):
            break
        T *= 1.05
    return q, dq / T, profile(middles)[2] / T**2, T


def _axis(model: Any, index: int) -> tuple[bool, ca.SX]:
    """Whether the joint turns, and its axis in its own frame."""
    joint = model.joints[index]
    if joint.nq != 1 or joint.nv != 1:
        raise ValueError(
            f"joint {model.names[index]!r} has {joint.nq} coordinates and "
            f"{joint.nv} speeds; one each is expected"
        )
    data = joint.createData()
    joint.calc(data, np.zeros(model.nq))
    subspace = np.asarray(data.S).ravel()
    revolute = bool(np.any(subspace[3:]))
    return revolute, _constant(subspace[3:] if revolute else subspace[:3])


def _rotation(axis: ca.SX, angle: ca.SX) -> ca.SX:
    """Rotation about a unit axis (Rodrigues)."""
    along = axis @ axis.T
    across = ca.SX(ca.sparsify(ca.DM(ca.SX.eye(3) - along)))
    turn = ca.SX(ca.sparsify(ca.DM(ca.skew(axis))))
    return ca.cos(angle) * across + ca.sin(angle) * turn + along


def _constant(values: Array) -> ca.SX:
    """Numbers as an expression in which zeros are structural."""
    kept = np.where(np.abs(values) < ROUND_OFF, 0.0, values)
    return ca.SX(ca.sparsify(ca.DM(kept)))
