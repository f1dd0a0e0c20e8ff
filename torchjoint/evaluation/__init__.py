"""Results against truth: reading both, scoring, and tables of scores."""
