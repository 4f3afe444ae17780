"""The cell: tours through stations, batches of plans, and where things stand."""
