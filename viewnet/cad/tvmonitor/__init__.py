"""Built-in CAD models: TVs and monitors."""
