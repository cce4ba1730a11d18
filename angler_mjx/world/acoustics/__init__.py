"""Sound under water as a means of talking: water, noise, links, who may send, and who hears."""
