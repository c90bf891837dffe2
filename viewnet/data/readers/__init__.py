"""A reader a data set, each written against its published layout."""
