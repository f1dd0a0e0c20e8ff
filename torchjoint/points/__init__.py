"""Steps 3 and 6: the graph of the points, and their segments."""
