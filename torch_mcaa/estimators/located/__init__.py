"""Jumps of a cell, located on the lines of a lattice and corrected for."""
