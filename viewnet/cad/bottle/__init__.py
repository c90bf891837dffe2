"""Built-in CAD models: bottles."""
