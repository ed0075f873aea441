"""Shape model of the bones: lattices fitted to patient bones, shape modes and their names, and reports."""
