"""Stand-ins that the project makes itself, in the layouts of the real data sets."""
