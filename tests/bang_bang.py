"""Extremals of bang-bang type, found by shooting.

The torques jump from limit to limit; the times of the switches are unknown. State and
transition matrix are integrated from switch to switch (DOP853, relative tolerance
1e-11), and T is minimised under the condition that the motion ends at the goal. The
costate follows from the conditions at the switches, and Pontryagin's conditions are
then checked along the whole motion.

The order in which the torques switch came from a direct method (IPOPT with Runge-Kutta
steps on the same equations, from many random starts; benchmarks/known_optima.py repeats
this), which also found no faster motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from reference_optima import Array, Task, linearized, state_rate
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

# Integration of extremals.
RELATIVE = 1e-11
ABSOLUTE = 1e-13
# Steps of Newton's method that end the search for the switches.
POLISHING = 6


@dataclass(frozen=True)
class Structure:
    """How the torques of a bang-bang motion switch.

    Attributes:
        first: The limit with which each joint begins, "+" or "-".
        order: The joint that switches, for each switch, "1" or "2".
        times: Times of the switches and of the end [s].
    """

    first: str
    order: str
    times: Sequence[float]

    @property
    def joints(self) -> list[int]:
        """Index of the joint that switches, for each switch."""
        return [int(joint) - 1 for joint in self.order]


@dataclass(frozen=True)
class Extremal:
    """A bang-bang motion, and how well it satisfies Pontryagin's conditions.

    Attributes:
        task: The problem.
        structure: The structure of its torques, with exact times.
        miss: Distance of the final state from the goal.
        at_switches: Largest value of a switching function where it should vanish, as a
            share of its largest value.
        wrong_sign: Largest value of a switching function where the torque has the wrong
            sign, as the same share.
        hamiltonian: Largest deviation of 1 + p^T f from zero.
    """

    task: Task
    structure: Structure
    miss: float
    at_switches: float
    wrong_sign: float
    hamiltonian: float

    @property
    def T(self) -> float:
        """Duration [s]."""
        return float(self.structure.times[-1])


class Shooting:
    """Motions of a task whose torques switch in a given order."""

    def __init__(self, task: Task, structure: Structure) -> None:
        self.task = task
        self.structure = structure
        self.torques = self._torques()

    def _torques(self) -> Array:
        """Torques of the arcs, shape (k + 1, n)."""
        upper = np.array([sign == "+" for sign in self.structure.first])
        rows = [upper.copy()]
        for joint in self.structure.joints:
            upper[joint] = ~upper[joint]
            rows.append(upper.copy())
        bounds = self.task.bounds
        return np.where(np.array(rows), bounds[:, 1], bounds[:, 0])

    def integrate(self, times: Array, samples: int = 0) -> list[tuple[Array, Array]]:
        """States and transition matrices on each arc.

        Args:
            times: Switches and end, shape (k + 1,).
            samples: Instants inside each arc.

        Returns:
            For each arc the states, shape (samples + 2, 2n), and the transition
            matrices from the start to them, shape (samples + 2, 2n, 2n).
        """
        mechanism, size = self.task.mechanism, self.task.ends.shape[1]
        y = np.concatenate([self.task.ends[0], np.eye(size).ravel()])
        arcs = []
        for begin, end, u in zip(
            np.concatenate([[0.0], times[:-1]]), times, self.torques, strict=True
        ):

            def rate(t: float, y: Array, u: Array = u) -> Array:
                f, by_x, _ = linearized(mechanism, y[:size], u)
                return np.concatenate(
                    [f, (by_x @ y[size:].reshape(size, size)).ravel()]
                )

            inside = np.linspace(begin, end, samples + 2)
            found = solve_ivp(
                rate,
                (begin, end),
                y,
                method="DOP853",
                t_eval=inside,
                rtol=RELATIVE,
                atol=ABSOLUTE,
            )
            y = found.y[:, -1]
            arcs.append((found.y[:size].T, found.y[size:].T.reshape(-1, size, size)))
        return arcs

    def end(self, times: Array) -> tuple[Array, Array]:
        """Final state and its derivative by the times, shapes (2n,) and (2n, k + 1)."""
        mechanism = self.task.mechanism
        arcs = self.integrate(times)
        final = arcs[-1][1][-1]
        columns = []
        for k, (states, matrices) in enumerate(arcs):
            x = states[-1]
            jump = state_rate(mechanism, x, self.torques[k])
            if k + 1 < len(arcs):
                jump = jump - state_rate(mechanism, x, self.torques[k + 1])
            columns.append(final @ np.linalg.solve(matrices[-1], jump))
        return arcs[-1][0][-1], np.stack(columns, axis=1)

    def polish(self, times: Array) -> Array:
        """Newton's method: the least change of good times so that the goal is met."""
        for _ in range(POLISHING):
            x, by_times = self.end(times)
            step, *_ = np.linalg.lstsq(by_times, x - self.task.ends[1], rcond=None)
            times = times - step
            if np.max(np.abs(step)) < 1e-12:
                return times
        raise ArithmeticError("the times of the switches do not converge")

    def search(self) -> Array:
        """Nearly exact times from rough times: the least T that meets the goal."""
        goal = self.task.ends[1]
        memory: dict[bytes, tuple[Array, Array]] = {}

        def end(times: Array) -> tuple[Array, Array]:
            key = times.tobytes()
            if key not in memory:
                memory[key] = self.end(times)
            return memory[key]

        count = len(self.structure.times)
        order = np.eye(count) - np.eye(count, k=-1)
        hits_goal = {
            "type": "eq",
            "fun": lambda times: end(times)[0] - goal,
            "jac": lambda times: end(times)[1],
        }
        in_order = {
            "type": "ineq",
            "fun": lambda times: order @ times,
            "jac": lambda times: order,
        }
        found = minimize(
            lambda times: times[-1],
            np.array(self.structure.times, dtype=np.float64),
            jac=lambda times: np.eye(count)[-1],
            method="SLSQP",
            constraints=[hits_goal, in_order],
            options={"ftol": 1e-14, "maxiter": 200},
        )
        return np.asarray(found.x)

    def costate(self, arcs: list[tuple[Array, Array]]) -> Array:
        """Costate p at the start, shape (2n,), from Pontryagin's conditions.

        With p^T f = -1 the torques of least time minimise p^T f, so that p^T f_u of a
        joint vanishes where the joint switches. As p(t) = Phi(t)^-T p(0), these are
        linear equations for p(0).
        """
        mechanism = self.task.mechanism
        rows = [state_rate(mechanism, self.task.ends[0], self.torques[0])]
        for k, joint in enumerate(self.structure.joints):
            states, matrices = arcs[k]
            _, _, by_u = linearized(mechanism, states[-1], self.torques[k])
            rows.append(np.linalg.solve(matrices[-1], by_u[:, joint]))
        scale = np.linalg.norm(rows, axis=1)
        right = np.zeros(len(rows))
        right[0] = -1.0 / scale[0]
        solution, *_ = np.linalg.lstsq(
            np.array(rows) / scale[:, None], right, rcond=None
        )
        return np.asarray(solution)

    def extremal(self, times: Array, samples: int = 40) -> Extremal:
        """Polish the times and check Pontryagin's conditions at many instants."""
        task, mechanism, joints = self.task, self.task.mechanism, self.structure.joints
        times = self.polish(times)
        arcs = self.integrate(times, samples)
        p0 = self.costate(arcs)
        middle = task.bounds.mean(axis=1)
        functions, signs, hamiltonian, at_switches = [], [], [], []
        for k, arc in enumerate(arcs):
            u = self.torques[k]
            for x, matrix in zip(*arc, strict=True):
                p = np.linalg.solve(matrix.T, p0)
                f, _, by_u = linearized(mechanism, x, u)
                functions.append(p @ by_u)
                signs.append(np.sign(u - middle))
                hamiltonian.append(1.0 + p @ f)
            if k < len(joints):
                at_switches.append(functions[-1][joints[k]])
        most = np.max(np.abs(functions), axis=0)
        return Extremal(
            task,
            Structure(self.structure.first, self.structure.order, tuple(times)),
            float(np.max(np.abs(arcs[-1][0][-1] - task.ends[1]))),
            float(np.max(np.abs(at_switches) / most[joints], initial=0.0)),
            float(np.max(np.array(signs) * np.array(functions) / most)),
            float(np.max(np.abs(hamiltonian))),
        )


def find_extremal(task: Task, structure: Structure, *, rough: bool = False) -> Extremal:
    """The extremal whose torques switch in a given order.

    Args:
        task: The problem.
        structure: The order, and the times to about 1e-4.
        rough: Whether the times are less exact than that.
    """
    shooting = Shooting(task, structure)
    times = shooting.search() if rough else np.array(structure.times, dtype=np.float64)
    return shooting.extremal(times)
