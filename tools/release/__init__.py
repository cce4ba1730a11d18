"""Release: versions that agree, files built in a clean folder and judged, a trial elsewhere."""
