"""Steps 4 and 5: the points that an image sees, its evidence about them, and checks of its pose."""
