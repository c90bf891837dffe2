"""Built-in CAD models: aeroplanes."""
