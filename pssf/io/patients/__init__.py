"""Read patient radiographs: file lists, images processed for display, and stored pixel values."""
