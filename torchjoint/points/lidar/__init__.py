"""Step 6 for one LiDAR scan: the ground, and what stands on it."""
