"""Steps 1 and 2: boundaries of an image, the graph of its pixels, its initial segments."""
