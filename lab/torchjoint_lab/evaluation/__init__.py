"""Scores of boundaries, tables of the paper, results of other methods."""
