"""Step 3: from a cloud to its graph."""
