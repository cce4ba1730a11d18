"""Maintenance of datasets: repair, merge, attach, summary."""
