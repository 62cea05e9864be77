"""The options, their types, and how a command line is checked."""
