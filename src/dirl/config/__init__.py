"""What can be configured, and how a command line is checked."""
