"""A solver of linear programs and a format of motion files, made by the recipes of
CONTRIBUTING.

Both are written from the interfaces alone: whatever else they needed would be missing
in the recipes.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest
from scipy.optimize import linprog

import tominpmp as tm
from tominpmp.files import export
from tominpmp.linear_programs import choice
from tominpmp.linear_programs.choice import make_solver
from tominpmp.linear_programs.program import LinearProgram, LpSolution
from tominpmp.linear_programs.solver import LpSolver
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.transcription.bspline import InverseTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram


class ScipySolver(LpSolver):
    """SciPy's ``linprog``."""

    def solve(self, program: LinearProgram) -> LpSolution:
        p, rows = program, program.matrix.tocsr()
        equal = p.row_lower == p.row_upper
        high = ~equal & np.isfinite(p.row_upper)
        low = ~equal & np.isfinite(p.row_lower)
        upper = np.concatenate([p.row_upper[high], -p.row_lower[low]])
        matrix = np.vstack([rows[high].toarray(), -rows[low].toarray()])
        bounds = np.stack([p.lower, p.upper], axis=1)
        found = linprog(
            p.cost, matrix, upper, rows[equal].toarray(), p.row_upper[equal], bounds
        )
        if found.x is None:
            none = np.zeros(p.row_lower.size)
            return LpSolution(False, np.zeros(p.cost.size), none, 0)
        duals = np.zeros(p.row_lower.size)
        duals[high] = -found.ineqlin.marginals[: np.count_nonzero(high)]
        duals[low] += found.ineqlin.marginals[np.count_nonzero(high) :]
        duals[equal] = -found.eqlin.marginals
        return LpSolution(found.status == 0, found.x, duals, found.nit)


def test_custom_solver_of_linear_programs_follows_the_recipe(
    planar3r: tm.Robot,
) -> None:
    problem = tm.Problem(planar3r, (0.5, 1.7, -1.7), tm.JointGoal((0.9, -1.2, -0.9)))
    transcription = InverseTranscription(
        ProblemFunctions.of(problem), interval_shares("uniform", 12), 2.0
    )
    ends = np.array([problem.q_start, problem.goal.q])

    def line(share: np.ndarray) -> np.ndarray:
        return ends[0] + share[:, None] * (ends[1] - ends[0])

    start = transcription.start(lambda t: line(t / 2.0), 2.0, np.array([2.0]))
    program = NonlinearProgram.of(transcription).at(start)
    options = tm.Options()
    least = MinimumTime.of(options)
    found = {
        name: solve(program, least, start, *trust_regions(options, lp))
        for name, lp in (("own", ScipySolver()), ("highs", make_solver("highs")))
    }
    assert found["own"].status is tm.Status.CONVERGED
    best = found["own"].best
    assert best is not None and found["highs"].best is not None
    assert best.violation <= tm.Options().feasibility
    assert best.duration == pytest.approx(found["highs"].best.duration, rel=1e-4)


def test_custom_solver_is_chosen_by_its_name(
    planar3r: tm.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(choice.SOLVERS, "own", ScipySolver)
    assert "own" in choice.available_solvers()
    problem = tm.Problem(planar3r, (0.5, 1.7, -1.7), tm.JointGoal((0.9, -1.2, -0.9)))
    options = {"intervals": 8, "effort": "quick", "refine": None}
    found = tm.plan(problem, lp_solver="own", max_planning_time=60.0, **options)
    assert (found.success, found.options.lp_solver) == (True, "own"), found.message


def write_words(samples: tm.Samples, file: BinaryIO) -> None:
    """The names of the joints in one line; then one line per instant: time and
    positions.
    """
    table = np.column_stack([samples.t, samples.q])
    rows = [" ".join(map(repr, row)) for row in table.tolist()]
    file.write("\n".join([" ".join(samples.joint_names), *rows]).encode())


def read_words(content: bytes, path: Path) -> tm.Samples:
    names, *rows = content.decode().split("\n")
    table = np.array([[float(word) for word in row.split()] for row in rows])
    none = np.full((table.shape[0], table.shape[1] - 1), np.nan)
    joints = tuple(names.split())
    return tm.Samples(joints, table[:, 0], table[:, 1:], none, none, none)


# The words have positions alone, between which a reader has to guess the torques.
@pytest.mark.filterwarnings("ignore:.*does not pass")
def test_custom_format_of_motion_files_follows_the_recipe(
    planar3r: tm.Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = export.Format(write_words, read_words)
    monkeypatch.setitem(export.FORMATS, ".words", words)
    problem = tm.Problem(planar3r, (0.5, 1.7, -1.7), tm.JointGoal((0.9, -1.2, -0.9)))
    smooth = {"starts": 1, "intervals": 10, "refine": None, "control": "spline"}
    solution = tm.plan(problem, **smooth)
    path = solution.export(tmp_path / "motion.words", dt=0.001)
    again = tm.load_motion(path)
    samples = solution.trajectory.sample(0.001)
    np.testing.assert_array_equal(again.t, samples.t)
    np.testing.assert_array_equal(again.q, samples.q)
    assert again.joint_names == planar3r.joint_names
    assert np.all(np.isnan(again.u))
    # Wrong samples are rejected like those of other formats.
    path.write_text(path.read_text().replace("joint1", "joint2"))
    with pytest.raises(
        tm.ScenarioError, match="names of joints, all of them different"
    ):
        tm.load_motion(path)
