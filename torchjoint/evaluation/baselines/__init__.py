"""What other methods write, read as segmentations: to be scored beside ours."""
