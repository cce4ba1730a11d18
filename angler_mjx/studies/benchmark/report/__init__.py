"""From the results folder of a benchmark to figures and a page."""
