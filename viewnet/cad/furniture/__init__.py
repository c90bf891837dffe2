"""Built-in CAD models: dining tables and sofas."""
