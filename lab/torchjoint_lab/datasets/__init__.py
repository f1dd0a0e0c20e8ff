"""Readers of data sets for research: of boundaries of images, and of a labelled LiDAR sweep."""
