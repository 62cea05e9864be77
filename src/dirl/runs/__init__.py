"""The files of a run, and how it is resumed from them."""
