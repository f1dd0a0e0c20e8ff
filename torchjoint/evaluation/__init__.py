"""Evaluation against ground truth: reads predictions, computes scores, makes tables of scores."""
