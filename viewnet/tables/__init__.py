"""Tables and figures of finished runs: measured beside reported numbers, as LaTeX, CSV and images."""
