"""Readers of data for research: BSDS500, boundary maps, 3D-SIS' example scenes, a labelled LiDAR sweep."""
