"""From a checkpoint to numbers: predictions, alignment, metrics and baselines."""
