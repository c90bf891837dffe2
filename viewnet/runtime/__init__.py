"""Files, processes, random numbers and provenance: used by all other packages."""
