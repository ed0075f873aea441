"""Study design: settings, classification tasks, manifest checks, and plans of designed radiographs."""
