"""Design of a study: settings, classification tasks, checks of manifests, and plans of designed radiographs."""
