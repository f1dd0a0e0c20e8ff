"""Presets of method regions, and the settings of the benchmark's methods."""
