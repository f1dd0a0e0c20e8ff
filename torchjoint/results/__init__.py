"""Output after step 8: the folder that a run writes, checkpoints, figures, corrections by hand, exports."""
