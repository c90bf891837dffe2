"""The overview page of all tables and figures: one HTML file."""
