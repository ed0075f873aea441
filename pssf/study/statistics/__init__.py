"""From predictions and features to numbers with intervals."""
