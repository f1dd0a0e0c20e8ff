"""Compares methods on labelled scenes, each method at its own best setting: ``torchjoint-lab benchmark``."""
