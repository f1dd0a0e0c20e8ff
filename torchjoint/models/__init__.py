"""The forest that comes with the package, and its card."""
