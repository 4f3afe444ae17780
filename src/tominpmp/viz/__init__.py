"""Pictures of motions: plots, playback in the browser, pages."""
