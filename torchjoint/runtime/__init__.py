"""What everything else runs on: threads, the stopwatch, files that are always whole."""
