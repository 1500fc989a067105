"""Charts of error against cost, on built-in scenes and on a user's own: `torch_mcaa.chart` and `mcaa chart`.

The chart is measured cell by cell, a cell being (scene, method, budget, seed), and kept in a folder:

=============  ======================================================================================================
results.json   settings, machine, truths, every cell and the summary; rewritten whole after each cell, so that an
               interrupted chart goes on where it was
results.csv    the summary: a line for each scene, method and budget
chart.svg,     the picture: error against evaluations and seconds, reported over true error, fitted exponents
chart.png
chart.html     the same, and pictures, error and evaluation maps to compare; a file that needs no network
measured/      the truths without a closed form, and the pictures of the page
=============  ======================================================================================================
"""

from __future__ import annotations

from torch_mcaa.charting.chart import Chart, chart

__all__ = ["Chart", "chart"]
