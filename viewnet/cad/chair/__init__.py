"""Built-in CAD models: chairs."""
