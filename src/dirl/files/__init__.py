"""Files that are complete or absent, and texts that are read with one-line errors."""
