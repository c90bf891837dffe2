"""Speed and memory, measured beside a textbook version of the same work."""
