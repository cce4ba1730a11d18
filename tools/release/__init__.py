"""Release: versions that agree, files built in a clean folder, judged, and tried where no checkout is."""
