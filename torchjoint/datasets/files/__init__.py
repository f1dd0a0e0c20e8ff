"""Types of files: images, clouds, cameras and bags, each with its own reader; errors name the file."""
