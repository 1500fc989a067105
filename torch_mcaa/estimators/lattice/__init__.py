"""Samples of shared lattices and points, weighed with the filter."""
