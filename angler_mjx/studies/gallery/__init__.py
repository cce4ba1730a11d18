"""Gallery: films of shipped scenarios, and a page about them, made by `angler gallery`.

`films` is the table of films, `making` flies their scenarios and renders them, `page` writes the
HTML page.
"""

from angler_mjx.studies.gallery.films import FILMS, Film
from angler_mjx.studies.gallery.making import make_gallery

__all__ = ["FILMS", "Film", "make_gallery"]
