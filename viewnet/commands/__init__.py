"""The commands of `viewnet`, by purpose: what each takes, and what it does with that.

A command is a function of the parsed arguments that prints its outcome and returns an exit code, None for 0. Whatever
takes time to import is imported by the command that needs it.
"""
