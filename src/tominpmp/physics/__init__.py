"""Replay of motions in MuJoCo, a simulator that shares no code with the planner."""
