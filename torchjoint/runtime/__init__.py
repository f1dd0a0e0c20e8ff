"""Infrastructure that all steps use: threads, the stopwatch, and atomic file writes."""
