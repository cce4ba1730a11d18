"""Style of figures, and the geometry of worlds that figures and the viewer show."""
