"""A check of motions without the library's verification.

Torques are integrated, and limits, obstacles and goals are checked. Only Pinocchio's
forward dynamics and SciPy's integrator are used, on a model that was not made from the
file that the library read.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from random_problems import NAMES, Case, place_of
from scipy.integrate import solve_ivp

import tominpmp as tm

Array = NDArray[np.float64]

# Tolerances of a success: the documented ones, with a tenth of them for the differences
# between two integrations and two grids of samples.
GOAL, SPEED, LIMITS, CONTACT = 1.1e-3, 1.1e-2, 5.5e-3, 2e-5
# Largest share of the effort that an unstable motion may take as feedback.
FEEDBACK = 2e-3
SAMPLES = 8


def faults(case: Case, solution: tm.Solution) -> list[str]:
    """Faults of a motion that counts as a success; the list should be empty."""
    motion = solution.trajectory
    assert motion is not None
    verification = solution.verification
    rate = 0.0
    # An error of 1e-9, as of an integrator, grows into a tenth of a tolerance.
    if verification is not None and verification.growth > 1e5:
        rate = 20.0 + 4.0 * np.log(max(verification.growth, 1.0)) / motion.duration
    q, v, u = _integrate(case, motion, rate)
    found = []
    if not np.allclose(motion.q[0], case.q_start, atol=2e-6):
        found.append("the motion does not begin at the start")
    found += _limit_faults(case, q, v, u)
    found += _goal_faults(case, q[-1], v[-1])
    for centre, radius in case.obstacles:
        clearance = _clearance(case, q, centre, radius)
        if clearance < case.margin - CONTACT:
            found.append(f"clearance of {clearance:.2e} m")
    return found


def nonfinite_values(solution: tm.Solution) -> list[str]:
    """Names of the values in a solution that are NaN, or infinite by mistake."""
    found = []
    values: dict[str, object] = {"planning_time": solution.planning_time}
    for label in ("trajectory", "initial"):
        motion = getattr(solution, label)
        for key in ("t", "q", "v", "u", "a") if motion is not None else ():
            part = getattr(motion, key)
            values[f"{label}.{key}"] = 0.0 if part is None else part
        if motion is not None:
            times = np.linspace(0.0, motion.duration, 50)
            values[f"{label}(t)"] = np.concatenate(motion(times), axis=1)
    for number, record in enumerate(solution.history):
        values[f"history[{number}]"] = (record.duration, record.radius)
    if solution.lower_bound is not None:
        values["lower_bound"] = solution.lower_bound.T
    if solution.success and solution.verification is not None:
        judged = solution.verification
        values["verification"] = (judged.goal_error, judged.speed_error, judged.growth)
        values["deviation"] = judged.deviation
    for name, value in values.items():
        if not np.all(np.isfinite(np.asarray(value, dtype=np.float64))):
            found.append(name)
    return found + [k for k, x in solution.violations.items() if np.isnan(x)]


def _integrate(
    case: Case, motion: tm.Trajectory, rate: float
) -> tuple[Array, Array, Array]:
    """Positions, velocities and torques of a replay with feedback at a rate [1/s]."""
    model = case.arm.model()
    data = model.createData()
    n, damping = case.arm.n, case.arm.column("damping")

    def torque(t: float, x: Array) -> Array:
        state = motion(t)
        if not rate:
            return state.u
        pull = rate * (rate * (state.q - x[:n]) + 2.0 * (state.v - x[n:]))
        return state.u + np.asarray(pin.crba(model, data, x[:n])) @ pull

    x = np.concatenate([case.q_start, case.v_start])
    rows = [(*x, *torque(0.0, x))]
    for begin, end in zip(motion.t[:-1], motion.t[1:], strict=True):
        last = np.nextafter(end, begin)

        def slope(t: float, x: Array, last: float = last) -> Array:
            u = torque(min(t, last), x) - damping * x[n:]
            a = pin.aba(model, data, x[:n], x[n:], u)
            return np.concatenate([x[n:], a])

        times = np.linspace(begin, end, SAMPLES)
        # Friction of a light link is stiff: the explicit integrator would crawl.
        result = solve_ivp(
            slope, (begin, end), x, "LSODA", times, rtol=1e-9, atol=1e-10
        )
        assert result.success, result.message
        for t, state in zip(times, result.y.T, strict=True):
            rows.append((*state, *torque(min(t, last), state)))
        x = result.y[:, -1]
    table = np.array(rows)
    q, v, u = np.split(table, [n, 2 * n], axis=1)
    return q, v, u


def _limit_faults(case: Case, q: Array, v: Array, u: Array) -> list[str]:
    arm = case.arm
    low, high = np.array(arm.column("effort")).T
    bottom, top, speed = (
        arm.column("lower"),
        arm.column("upper"),
        arm.column("velocity"),
    )
    width = np.where(np.isfinite(top - bottom), top - bottom, 1.0)
    excesses = {
        "position": np.maximum(q - top, bottom - q) / width,
        "velocity": np.abs(v) / speed - 1.0,
        "effort": np.maximum(u - high, low - u) / (high - low),
    }
    return [
        f"{kind} of {NAMES[worst]} is {np.max(excess):.2e} beyond its limit"
        for kind, excess in excesses.items()
        if np.max(excess[:, worst := int(np.argmax(np.max(excess, axis=0)))]) > LIMITS
    ]


def _goal_faults(case: Case, q: Array, v: Array) -> list[str]:
    found = [_faults_of_goal(case, kind, values, q, v) for kind, values in case.goals]
    if case.any_of:
        return [] if not all(found) else ["no goal is reached: " + str(found)]
    return [text for texts in found for text in texts]


def _distances(case: Case, change: Array, columns: Sequence[int]) -> Array:
    """Distances of joint positions; those of continuous joints are angles."""
    turns = np.array([case.arm.bodies[i].kind == "continuous" for i in columns])
    angle = np.abs((change + np.pi) % (2.0 * np.pi) - np.pi)
    return np.where(turns, angle, np.abs(change))


def _faults_of_goal(
    case: Case, kind: str, values: dict, q: Array, v: Array
) -> list[str]:
    excess_of: dict[str, float] = {}
    speed = v
    if kind == "joint":
        excess_of["joint"] = np.max(_distances(case, q - values["q"], range(q.size)))
        speed = v if values["v"] is None else v - values["v"]
    elif kind == "joint region":
        columns = [NAMES.index(name) for name in values["joints"]]
        apart = _distances(case, q[columns] - values["q"], columns)
        excess_of["joint"] = np.max(apart) - values["tolerance"]
    else:
        excess_of = _frame_errors(case, kind, values, q)
    found = [f"{kind}: {k} is {x:.2e} off" for k, x in excess_of.items() if x > GOAL]
    if np.max(np.abs(speed)) > SPEED:
        found.append(f"{kind}: speed is {np.max(np.abs(speed)):.2e} off")
    return found


def _frame_errors(case: Case, kind: str, values: dict, q: Array) -> dict[str, float]:
    model = case.arm.model()
    placement = place_of(case.arm, model, model.createData(), q)
    within = values.get("tolerance", 0.0)
    angle = values.get("angle_tolerance", 0.0)
    excess_of: dict[str, float] = {}
    if values.get("position") is not None:
        away = np.linalg.norm(placement.translation - values["position"])
        excess_of["position"] = float(away) - within
    if kind == "axis":
        cosine = (placement.rotation @ values["axis"]) @ values["direction"]
        excess_of["axis"] = float(np.arccos(np.clip(cosine, -1.0, 1.0))) - angle
        # Smaller angles cannot be computed from the cosine.
        excess_of["axis"] = excess_of["axis"] if excess_of["axis"] > 1e-3 else 0.0
    if kind == "pose":
        error = values["pose"].actInv(placement)
        excess_of["position"] = float(np.linalg.norm(error.translation)) - within
        excess_of["turn"] = float(np.linalg.norm(pin.log3(error.rotation))) - angle
    if kind == "region":
        error = values["pose"].actInv(placement)
        x = error.translation
        excess_of["region"] = float(
            np.max(np.maximum(x - values["upper"], values["lower"] - x))
        )
        if angle < np.pi:
            excess_of["turn"] = float(np.max(np.abs(pin.log3(error.rotation)))) - angle
    return excess_of


def _clearance(case: Case, q: Array, centre: Array, radius: float) -> float:
    """Smallest distance of the balls on the links from a sphere."""
    model = case.arm.model()
    data = model.createData()
    least = np.inf
    for row in q:
        pin.forwardKinematics(model, data, row)
        for i, body in enumerate(case.arm.bodies):
            if body.ball is not None:
                at = data.oMi[i + 1].act(body.ball[0])
                away = float(np.linalg.norm(at - centre)) - radius - body.ball[1]
                least = min(least, away)
    return least
