"""Steps 4 and 5: the points that an image sees, the evidence of the image, and checks of its pose."""
