"""What to do with a motion: play, plot, export."""
