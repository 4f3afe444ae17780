"""Planning: the story from a problem to a motion, which begins in planning.py."""
