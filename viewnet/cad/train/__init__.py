"""Built-in CAD models: trains."""
