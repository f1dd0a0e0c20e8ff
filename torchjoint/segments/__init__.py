"""Steps 3 and 6: the point graph, and the segmentation of the points."""
