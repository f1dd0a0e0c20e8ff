"""Step 6, method scan: the ground of one LiDAR scan, and the objects on it."""
