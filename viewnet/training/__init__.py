"""From pairs of views to a checkpoint, and the run store that trains whatever is missing."""
