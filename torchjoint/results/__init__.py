"""Results: the folder that a run writes, checkpoints, figures."""
