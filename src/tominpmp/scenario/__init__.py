"""Files that describe a planning problem: scenarios, and those of MoveIt."""
