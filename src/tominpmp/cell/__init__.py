"""Work cells: tours through stations, batches of plans, and placement of equipment."""
