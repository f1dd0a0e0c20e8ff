"""Methods side by side on labelled scenes, each at its own best setting: ``torchjoint benchmark``."""
