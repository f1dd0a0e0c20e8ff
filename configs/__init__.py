"""The presets that come with the package, installed as `torchjoint.configs`."""
