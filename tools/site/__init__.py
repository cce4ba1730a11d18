"""Site of the documentation: menu, staged pages, build by Sphinx, checks of the result."""
