"""Initial guesses: paths, their timing, inverse kinematics, and warm starts."""
