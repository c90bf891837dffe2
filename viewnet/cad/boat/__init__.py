"""Built-in CAD models: boats."""
