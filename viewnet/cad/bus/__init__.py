"""Built-in CAD models: buses."""
