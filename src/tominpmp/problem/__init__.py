"""Planning problems: robot, start, goals and obstacles, of one arm or a workcell."""
