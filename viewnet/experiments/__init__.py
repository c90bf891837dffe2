"""What notebooks ask for: checked, trained where missing, and turned into tables and figures."""
