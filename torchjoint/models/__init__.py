"""Data that come with the package: trained models and their card; the demo's recording, demo/."""
