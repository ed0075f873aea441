"""Patient radiographs: lists of files, images as displayed, and stored pixel values."""
