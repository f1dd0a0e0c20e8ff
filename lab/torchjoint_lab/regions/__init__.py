"""Step 6, method regions: hand-made costs of boundaries, and the presets that were tuned with it."""
