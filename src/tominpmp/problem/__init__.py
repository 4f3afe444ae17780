"""Planning problems: robot, start, goals and obstacles, of one arm or a workcell."""

from tominpmp.problem.problem import Problem

__all__ = ["Problem"]
