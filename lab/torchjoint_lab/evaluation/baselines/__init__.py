"""Reads results of the baselines as segmentations, so that they can be scored."""
