"""Initial guesses: paths, timing, inverse kinematics, warm starts, and processes."""
