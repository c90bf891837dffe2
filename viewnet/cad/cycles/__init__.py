"""Built-in CAD models: bicycles and motorbikes."""
