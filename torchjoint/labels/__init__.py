"""Steps 7 and 8: the final labels of the images, in one id space with the points."""
