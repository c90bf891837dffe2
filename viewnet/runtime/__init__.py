"""Files, processes, random numbers and provenance: what every room stands on."""
