"""Steps 4 and 5: which points an image sees, what it says about them, and whether its pose can be right."""
