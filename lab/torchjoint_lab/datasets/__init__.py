"""Readers of data sets for training and evaluating boundaries of images."""
