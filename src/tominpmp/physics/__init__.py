"""A second opinion: motions in a simulator that shares no code with the planner."""
