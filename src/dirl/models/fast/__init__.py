"""Faster equivalents of the plain modules; a test compares each with its plain form."""
