"""Plots as SVG text made here, from numbers alone: no script is needed to see them, and they follow the page's colours in light, dark and print."""
