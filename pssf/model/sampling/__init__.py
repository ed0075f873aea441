"""Sample knees, acquisitions and display processing from tables of probability distributions."""
