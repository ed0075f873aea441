"""Random sampling of knees, acquisitions and display processing from the package's tables of distributions."""
