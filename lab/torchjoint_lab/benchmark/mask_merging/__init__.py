"""Published ways to bring masks of images to a point cloud, written from their papers, to compare with.

Each is a function of the points, the visible points of each frame, the masks of each frame and superpoints; it returns
labels of all points. Masks that overlap become a label map first, as in the papers: the smallest mask counts.
"""
