"""The estimators of Halton's paper, which draw points for each pixel."""
