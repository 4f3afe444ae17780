"""Initial guesses."""
