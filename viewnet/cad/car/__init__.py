"""Built-in CAD models: cars."""
