"""The trained models that come with the package, and their cards."""
