"""`angler validate`: measured quantities, their references and deviations, as page and JSON."""
