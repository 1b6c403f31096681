"""The command line: a dataclass is a command's options and help."""
