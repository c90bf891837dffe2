"""The commands of `viewnet`, a module each.

A module's docstring is the command's help: a summary, a description and examples. `ARGUMENTS` are its
arguments; `run` takes them parsed, prints the results and returns an exit code (None is 0). What takes long to import
is imported inside of `run`.
"""
