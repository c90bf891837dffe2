"""Reading CAD collections and keeping rendered views."""
