"""From pairs of views to a checkpoint: the steps of a training and its loop."""
