"""Files of motions, scenarios and limits, MoveIt's files, and checks of exports."""
