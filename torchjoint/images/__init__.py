"""Steps 1 and 2: boundaries of an image, its pixel graph and its initial segments."""
