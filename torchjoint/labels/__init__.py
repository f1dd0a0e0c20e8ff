"""Steps 7 and 8: the final labels of the images, and one id space for points and pixels."""
